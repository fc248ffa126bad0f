class Doubt(UserWarning):
    """A warning that values in a file may not mean what they say, and that the answer depends on
    them.

    Readers of files issue it in one line with the file, the number of values and what was done.
    Every command prints it on standard error above the answer.
    """
