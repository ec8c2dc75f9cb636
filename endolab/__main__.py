"""python -m endolab."""

from __future__ import annotations

from endolab.cli.main import main

raise SystemExit(main())
