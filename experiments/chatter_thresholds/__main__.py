"""``python -m experiments.chatter_thresholds``; see `run`."""

from experiments.chatter_thresholds.run import main

raise SystemExit(main())
