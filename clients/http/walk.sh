#!/bin/sh
# Own data to a volume with axes, direct and iterative: walk.sh RECORDING [ADDRESS]. Needs curl 7.83 or newer.
# RECORDING is what docs/formats.md says, for example an .npz with traces, positions and sampling_interval.
set -eu
recording=$1 at=${2:-http://127.0.0.1:8000} wait='Prefer: wait=50'
api() { curl --silent --show-error --fail-with-body "$@"; }
field() { sed "s/.*\"$1\":\"\([^\"]*\)\".*/\1/"; }

upload=$(api "$at/api/v1/uploads" --data-binary "@$recording" -H 'Content-Type: application/octet-stream' | field id)
scan=$(api "$at/api/v1/jobs" -H "$wait" -H "Idempotency-Key: $upload" --json '{"kind": "import", "upload_id": "'"$upload"'"}' | field scan_id)

for method in nedner iterative; do
    made=$(api "$at/api/v1/reconstructions" -o answer.json -w '%header{location}' -H "Idempotency-Key: $scan-$method" \
        --json '{"scan_id": "'"$scan"'", "parameters": {"method": "'$method'", "modes": 32}}')
    made="$at/api/v1/reconstructions/${made##*/}"
    api "$made" -H "$wait" -o "$method.json"                          # shape, origin_m and spacing_m: the axes
    api "$made/volume" -H 'Accept: application/x-npy' -o "$method.npy"    # float32 [x, y, z]
    api "$made/mip?axis=z" -o "$method.png"
done
