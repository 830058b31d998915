"""The path rules of Yu and Masuzawa, each switched on and off in simulation.

Importing this package turns on 64-bit floats, which the simulation needs.
"""

import jax

jax.config.update("jax_enable_x64", True)
