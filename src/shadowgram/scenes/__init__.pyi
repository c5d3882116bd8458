from .colour import auto_exposure as auto_exposure
from .colour import to_rgb as to_rgb
from .colour import wavelength_rgb as wavelength_rgb
from .datacube import as_datacube as as_datacube
from .generated import chart as chart
from .readers import read as read
from .readers import write as write
