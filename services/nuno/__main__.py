"""`python -m nuno` is the `nuno` command."""

from nuno.cli import main

raise SystemExit(main())
