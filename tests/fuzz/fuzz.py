"""Coverage-guided fuzzing of the driver. Five minutes of each target, from the repository's root:

    pip install atheris
    for target in deframer device host; do
        mkdir -p /tmp/fuzz-$target  # new inputs go there, the corpus of the repository stays as it is
        python tests/fuzz/fuzz.py $target /tmp/fuzz-$target tests/fuzz/corpus/$target -max_total_time=300
    done

Options behind the target are libFuzzer's. An input that fails is written to ``crash-…``; give its path as the only
further argument to run it again.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["fabry_perot", "cobs", "cbor2"]):
    from targets import TARGETS

if __name__ == "__main__":
    atheris.Setup([sys.argv[0], *sys.argv[2:]], TARGETS[sys.argv[1]])
    atheris.Fuzz()
