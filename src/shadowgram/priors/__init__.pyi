from .bm3d import BM3D as BM3D
from .denoiser import Denoiser as Denoiser
from .denoiser import get as get
from .ffdnet import FFDNet as FFDNet
from .tv_denoiser import TVDenoiser as TVDenoiser
