"""Write, read and repair the files of a sweep."""
