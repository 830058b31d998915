"""Whether a threshold keeps the rate of false alarms that it states, on cuts it has not seen.

Importing this package turns on 64-bit floats, which the simulation needs.
"""

import jax

jax.config.update("jax_enable_x64", True)
