"""Results as HTML, Markdown, JUnit XML and text."""
