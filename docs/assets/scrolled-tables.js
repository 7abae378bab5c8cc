// A table wider than the page scrolls in a frame that the theme puts round it: by keyboard too.
document$.subscribe(() => {
  for (const frame of document.querySelectorAll(".md-typeset__scrollwrap")) frame.tabIndex = 0;
});
