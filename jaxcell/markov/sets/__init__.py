"""Sets of cells that a chain hardly leaves, and the eigenvectors that reveal them."""
