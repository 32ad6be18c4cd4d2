"""The one exception that a user is meant to read."""


class StepdiagError(Exception):
    """Something given to stepdiag is wrong and stepdiag can say what.

    The message is one line: it names the file, the topic or field, what is
    wrong and what to do about it.  Commands print it and exit with status 2.
    """
