"""Maps as files and pictures, and random ones."""
