#!/bin/sh
# Own data to volumes with their axes, direct and iterative: own_data.sh RECORDING. Needs steradian-client and
# Python. STERADIAN_URL and STERADIAN_KEY say where; RECORDING is what docs/formats.md says, for example an .npz.
set -eu
field() { python3 -c 'import json, sys; print(json.load(sys.stdin)[sys.argv[1]])' "$1"; }

scan=$(steradian-client scan import "$1" --json | field id)
for method in nedner iterative; do
    job=$(steradian-client reconstruction create "$scan" "method=$method" modes=32 --json | field id)
    steradian-client reconstruction watch "$job" --json >"$method.json" # its report: shape, origin_m and spacing_m, the axes
    steradian-client reconstruction volume "$job" "$method.npy"         # float32 [x, y, z]
    steradian-client reconstruction mip "$job" "$method.png"
done
