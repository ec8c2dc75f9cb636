"""python -m endolab."""

from endolab.cli import main

raise SystemExit(main())
