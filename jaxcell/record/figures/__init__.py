"""Results in a notebook: a plot of any result, and its numbers with a picture as HTML."""
