"""The error for something that the user gave and can put right."""


class InputError(ValueError):
    """Something given is wrong; the text is one sentence with file, row or parameter and remedy."""
