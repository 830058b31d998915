"""``python -m experiments.guo_wedg_electrodes``; see `run`."""

from experiments.guo_wedg_electrodes.run import main

raise SystemExit(main())
