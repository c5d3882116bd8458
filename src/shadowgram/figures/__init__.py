"""Pictures and the report; the only part that imports matplotlib.

- `style`: colours, fonts, and how a figure becomes PNG bytes, on light or dark paper.
- `codes`: patterns, spectra and statistics of a code, and of its sensing matrix.
- `masks`: codes as pictures at their physical size, and frames of a micromirror device.
- `images`: cubes in true colour with a zoom, codes, snapshots.
- `lines`: spectra and quality over the bands.
- `resolution`: what an SSCSI resolves over the position of its mask.
- `overview`: scene → code → snapshot → reconstruction in one picture.
- `report`: the HTML page of the demo.
- `sheet`: panels of curves, pictures and maps in rows, for the studies.

Every function takes arrays and returns a matplotlib `Figure` that belongs to no window and no global state.
"""
