"""``python -m experiments.yu_1997_cavities``; see `run`."""

from experiments.yu_1997_cavities.run import main

raise SystemExit(main())
