"""The command `shadowgram`: arguments → a run → files and figures; no science happens here.

- `main`: entry point; every error that a user can mend becomes one line and exit status 2.
- `demo`, `files` (info, convert, compare), `cameras` (capture, resolution), `recovery` (reconstruct), `masks` (codes make),
  `benchmark` (bench): the commands.
- `arguments`, `output`: what they share.

Whatever takes time to import is imported inside the commands, so that ``--help`` answers at once.
"""

from .main import main as main

__all__ = ["main"]
