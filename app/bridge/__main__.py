"""``python -m app.bridge``: see :mod:`app.bridge.command`."""

from app.bridge.command import main

main()
