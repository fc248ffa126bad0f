"""Read and write map files, and draw random maps."""
