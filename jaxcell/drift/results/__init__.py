"""Results: what is asked of one layer of a current, and of all of them."""
