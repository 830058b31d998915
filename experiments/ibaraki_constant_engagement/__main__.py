"""``python -m experiments.ibaraki_constant_engagement``; see `run`."""

from experiments.ibaraki_constant_engagement.run import main

raise SystemExit(main())
