"""Results in notebooks: plots of quantities, and HTML with numbers and a picture."""
