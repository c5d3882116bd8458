"""The command `shadowgram`: arguments → a run → files and figures; no science happens here.

- `main`: entry point; every error that a user can mend becomes one line and exit status 2.
- `files` (info, convert, compare), `cameras` (capture), `recovery` (reconstruct), `masks` (codes make),
  `code_design`, `code_analysis`, `mask_export` (codes design, analyse, export), `resolution`, `study`, `benchmark` (bench),
  `denoiser` (import), `demo`.
- `arguments`, `output`, `cubes`, `code_imager`: what they share. `code_search`: a design that may be interrupted.

Whatever takes time to import is imported inside the commands, so that ``--help`` answers at once.
"""

from .main import main as main

__all__ = ["main"]
