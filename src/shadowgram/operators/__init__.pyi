from .adapters import as_matrix as as_matrix
from .adapters import as_scipy as as_scipy
from .base import Adjoint as Adjoint
from .base import Compose as Compose
from .base import LinearOperator as LinearOperator
from .structure import norm as norm
from .structure import shot_gram as shot_gram
from .transforms import basis as basis
