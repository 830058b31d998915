"""``python -m experiments.yu_1997_path_rules``; see `run`."""

from experiments.yu_1997_path_rules.run import main

raise SystemExit(main())
