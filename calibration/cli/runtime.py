"""Sets JAX up for a command: 64-bit floats, CPU, and the compilation cache."""

import os
from pathlib import Path


def prepare_jax() -> None:
    """Enable 64-bit floats and keep compiled programs between runs.

    Environment settings of the user's own (``JAX_PLATFORMS``, ``JAX_COMPILATION_CACHE_DIR``) are
    left as they are. Without them fits run on the CPU, which is faster for a few parameters, and
    the cache lies in the user's cache folder.
    """
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.config.jax_compilation_cache_dir is not None:
        return
    folder = _cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # without a place to write, every run compiles anew
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # By default only programs that took long are kept; ours are many small ones.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "procmodel" / "jax"
