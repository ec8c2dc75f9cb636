"""python -m endolab."""

from endolab.cli.main import main

raise SystemExit(main())
