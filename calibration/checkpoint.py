"""Checkpoints of long runs: HDF5 files that are complete or not there, tied to a configuration."""

import hashlib
import importlib.metadata
import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from procmodel.errors import InputError
from procmodel.io import check_target, writing

Arrays = dict[str, np.ndarray]

# A write may take this share of the run's time, with the work that a kill loses kept short.
_SHARE_OF_TIME = 0.02
_LEAST_SECONDS = 0.5


class Checkpoint:
    """The state of a run, in a file.

    Parameters
    ----------
    path : path-like
        The file, ending in .h5.
    configuration : dict
        Everything the result depends on, as plain types. A file of another configuration is
        refused by the name of what differs.
    resume : bool
        Whether to go on from the file if it is there. Without it an existing file is refused.

    Raises
    ------
    InputError
        If the file cannot be written, exists without `resume`, is not a checkpoint, or belongs
        to another configuration.
    """

    def __init__(self, path: Any, configuration: dict[str, Any], resume: bool):
        self.path = Path(path)
        if self.path.suffix.lower() not in (".h5", ".hdf5"):
            raise InputError(f"{self.path.name}: a checkpoint ends in .h5: rename it.")
        check_target(self.path)
        versions = {f"{name} version": importlib.metadata.version(name) for name in _LIBRARIES}
        self._configuration = {**configuration, **versions, "device": jax.default_backend()}
        if self.path.exists() and not resume:
            raise InputError(
                f"{self.path.name} exists: resume the run, delete the file, or name another."
            )
        self._due = 0.0
        for draft in self.path.parent.glob(f".{self.path.stem[:40]}-{'?' * 16}{self.path.suffix}"):
            draft.unlink(missing_ok=True)  # what a killed run left behind

    @property
    def digest(self) -> str:
        """Hash of the configuration, 12 digits."""
        text = json.dumps(self._configuration, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def load(self) -> Arrays | None:
        """Arrays of the file; None when there is none yet.

        Returns
        -------
        dict of str to ndarray, or None
            What was saved last.

        Raises
        ------
        InputError
            If the file is of another configuration or cannot be read.
        """
        import h5py

        if not self.path.exists():
            return None
        try:
            with h5py.File(self.path) as file:
                written = json.loads(file.attrs["configuration"])
                arrays = {name: np.asarray(file[name]) for name in file}
        except (OSError, KeyError, ValueError):
            raise InputError(
                f"{self.path.name} is not a checkpoint of this library: delete it or name another."
            ) from None
        for name in sorted({*written, *self._configuration}):
            was, now = written.get(name), self._configuration.get(name)
            if was != now:
                raise InputError(
                    f"{self.path.name} belongs to a run with {name} {_short(was)}, this one has "
                    f"{_short(now)}: run with the same settings, or name another checkpoint."
                )
        return arrays

    @property
    def due(self) -> bool:
        """Whether the last write was long enough ago for another."""
        return time.monotonic() >= self._due

    def save(self, arrays: Arrays) -> None:
        """Write the state.

        Parameters
        ----------
        arrays : dict of str to array
            The state.
        """
        import h5py

        begin = time.monotonic()
        with writing(self.path) as draft, h5py.File(draft, "w") as file:
            file.attrs["configuration"] = json.dumps(self._configuration, sort_keys=True)
            file.attrs["digest"] = self.digest
            for name, array in arrays.items():
                file[name] = np.asarray(array)
        taken = time.monotonic() - begin
        self._due = time.monotonic() + max(_LEAST_SECONDS, taken / _SHARE_OF_TIME)


_LIBRARIES = ("procmodel", "jax", "jaxlib", "numpy")


def _short(value: Any) -> str:
    text = "none" if value is None else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
