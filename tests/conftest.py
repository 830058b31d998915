"""Settings of all tests: double precision, no compilation cache, patient hypothesis."""

import gc
import os
import tomllib
from pathlib import Path

import jax
import pytest
from hypothesis import settings

jax.config.update("jax_enable_x64", True)
# A test must not pass or fail by what an earlier run compiled, unless the user wants the cache.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    jax.config.update("jax_enable_compilation_cache", False)

# Compilation inside an example takes longer than hypothesis' deadline.
settings.register_profile("procmodel", deadline=None, max_examples=30)
settings.load_profile("procmodel")

# Compiled code keeps pages mapped, and a process may have 65,530 of them: far more tests in one
# process than these end in a crash.
_MOST_PAGES = 20_000
_PAGES = Path("/proc/self/maps")

REFERENCE = Path(__file__).parent / "reference"


@pytest.fixture(scope="module", autouse=True)
def bounded_compiled_code():
    """Forget what was compiled, after a file of tests, before it is too much for the process."""
    yield
    if _PAGES.exists() and _PAGES.read_bytes().count(b"\n") > _MOST_PAGES:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(scope="session")
def wear_reference():
    """Known answers of the wear laws, with their source, from ``reference/wear.toml``."""
    return tomllib.loads((REFERENCE / "wear.toml").read_text())


@pytest.fixture(scope="session")
def nist_reference():
    """Certified regressions from ``reference/nist_strd.toml``."""
    return tomllib.loads((REFERENCE / "nist_strd.toml").read_text())
