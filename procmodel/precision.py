"""The check for 64-bit floats that every calibrating entry point makes."""

import jax


def require_float64(what: str) -> None:
    """Refuse to go on in single precision.

    Parameters
    ----------
    what : str
        What needs the precision, as the subject of the sentence.

    Raises
    ------
    RuntimeError
        If JAX still makes 32-bit floats.
    """
    if not jax.config.jax_enable_x64:
        raise RuntimeError(
            f"{what} needs 64-bit floats: call jax.config.update('jax_enable_x64', True) "
            "at the top of the script, before the first array is made."
        )
