"""The one-shot classifier: classes from one scan alone, the baseline of the classes from a latent state."""
