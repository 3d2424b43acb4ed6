"""A scan of several wavelengths and frames to oxygen saturation: series.py SCAN.h5 leaves pictures and maps here."""

import sys

import numpy as np

from steradian_client import Client

with Client() as service:  # STERADIAN_URL and STERADIAN_KEY say where
    scan = service.imports.import_file(sys.argv[1], progress=print)
    series = service.reconstructions.create(scan.id, modes=24, depth_range=[0.6e-3, 1.6e-3])
    series = service.reconstructions.wait(series, progress=print)
    for index, frame in enumerate(series.report["frames"]):
        brightest = service.reconstructions.volume(series.id, index=index).values.max()
        print(f"frames {frame['numbers']} at {1e9 * frame['excitation_m']:.0f} nm: {brightest:.4g}")
    service.reconstructions.download_mip(series.id, "series.png")  # all volumes with one scale
    service.exports.export_and_download("nifti", ".", reconstruction_id=series.id)  # one 4-D file

    maps = service.reconstructions.unmix(series.id, fluence={"model": "uniform"})
    maps = service.reconstructions.wait(maps, progress=print)
    names = [frame["name"] for frame in maps.report["frames"]]
    saturation = service.reconstructions.volume(maps.id, index=names.index("saturation")).values
    found = maps.report["unmixing"]["saturation"]
    count = np.isfinite(saturation).sum()
    print(f"saturation {found['mean']:.3f} ± {found['median_standard_error']:.2g} in {count} voxels")
    service.reconstructions.download_mip(maps.id, "saturation.png")
