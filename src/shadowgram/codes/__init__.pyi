from .patterns import boolean as boolean
from .patterns import check_code as check_code
from .patterns import colored as colored
from .patterns import random as random
