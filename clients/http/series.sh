#!/bin/sh
# A scan of several wavelengths to a series and oxygen saturation: series.sh SCAN.h5 [ADDRESS]. Needs curl 7.83 or newer.
set -eu
scan_file=$1 at=${2:-http://127.0.0.1:8000} wait='Prefer: wait=50' npy='Accept: application/x-npy'
api() { curl --silent --show-error --fail-with-body "$@"; }
field() { sed "s/.*\"$1\":\"\([^\"]*\)\".*/\1/"; }

upload=$(api "$at/api/v1/uploads" --data-binary "@$scan_file" -H 'Content-Type: application/octet-stream' | field id)
scan=$(api "$at/api/v1/jobs" -H "$wait" --json '{"kind": "import", "upload_id": "'"$upload"'"}' | field scan_id)

made=$(api "$at/api/v1/reconstructions" -o answer.json -w '%header{location}' \
    --json '{"scan_id": "'"$scan"'", "parameters": {"modes": 24, "depth_range": [0.6e-3, 1.6e-3]}}')
series=${made##*/}
api "$at/api/v1/reconstructions/$series" -H "$wait" -o series.json                          # report.frames: the volumes
api "$at/api/v1/reconstructions/$series/volume?index=0" -H "$wait" -H "$npy" -o volume-0.npy # the first of them
api "$at/api/v1/reconstructions/$series/mip" -H 'Accept: image/png' -o series.png            # all, with one scale

made=$(api "$at/api/v1/reconstructions" -o answer.json -w '%header{location}' \
    --json '{"scan_id": "'"$scan"'", "reconstruction_id": "'"$series"'", "unmixing": {"fluence": {"model": "uniform"}}}')
maps="$at/api/v1/reconstructions/${made##*/}"
api "$maps" -H "$wait" -o saturation.json                               # report.unmixing.saturation: mean and percentiles
api "$maps/volume?index=0" -H "$wait" -H "$npy" -o saturation.npy       # NaN where there is no signal
api "$maps/mip" -H 'Accept: image/png' -o saturation.png
