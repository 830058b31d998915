"""The error for something that the user gave and can put right."""

import difflib
from collections.abc import Sequence


class InputError(ValueError):
    """Something given is wrong; the text is one sentence with file, row or parameter and remedy."""


def nearest(word: str, known: Sequence[str]) -> str:
    """Hint for a misspelt name.

    Parameters
    ----------
    word : str
        What was written.
    known : sequence of str
        What could have been meant.

    Returns
    -------
    str
        ``"; did you mean 'x'?"`` or ``"; known are a, b"``.
    """
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; known are {', '.join(known)}"
