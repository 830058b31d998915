"""``python -m experiments.nishikawa_chatter_avoidance``; see `run`."""

from experiments.nishikawa_chatter_avoidance.run import main

raise SystemExit(main())
