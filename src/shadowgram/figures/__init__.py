"""Pictures and the report; the only part that imports matplotlib.

- `style`: colours, fonts, and how a figure becomes PNG bytes, on light or dark paper.
- `images`: cubes in true colour with a zoom, codes, snapshots.
- `lines`: spectra, quality over the bands, resolution over the mask position.
- `overview`: scene → code → snapshot → reconstruction in one picture.
- `report`: the HTML page of the demo.

Every function takes arrays and returns a matplotlib `Figure` that belongs to no window and no global state.
"""
