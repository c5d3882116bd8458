from . import codes as codes
from . import measurement as measurement
from . import metrics as metrics
from . import noise as noise
from . import operators as operators
from . import priors as priors
from . import scenes as scenes
from . import solvers as solvers
from . import spectral as spectral
from . import testing as testing
from . import xray as xray
from ._threads import threads as threads
from .operators.base import LinearOperator as LinearOperator
from .solvers.admm import ADMM as ADMM
from .solvers.eigen_tv import EigenTV as EigenTV
from .solvers.fista import FISTA as FISTA
from .solvers.gpsr import GPSR as GPSR
from .solvers.solution import Solution as Solution
from .solvers.solution import solve as solve
from .spectral.cassi import CASSI as CASSI
from .spectral.cassi import DualCASSI as DualCASSI
from .spectral.colored import ColoredCASSI as ColoredCASSI
from .spectral.sscsi import SSCSI as SSCSI
from .xray.cxbi import CXBI as CXBI

__version__: str
