#!/usr/bin/env bash
# Prove and measure the GPU engine on a machine with a CUDA device, in one command.
#
#   benchmarks/gpu_session.sh tests       the engine's tests, on the device: a line for each, and their output in tests.log
#   benchmarks/gpu_session.sh benchmark   python -m steradian_benchmarks gpu: a table, gpu.json, and docs/performance.md with it
#   benchmarks/gpu_session.sh all         both
#   benchmarks/gpu_session.sh fetch       beforehand, where an index of packages can be reached: wheels into .wheels
#   benchmarks/gpu_session.sh collect     keep what came in .wheels/part-N
#
# Files go to the folder $OUT (default: gpu-session). With $PYTHON, that interpreter has all packages. Where there is a folder
# .wheels, what is missing comes from there, with neither an index nor a virtual environment: for machines that reach
# nothing. Otherwise a virtual environment in .gpu-venv gets '.[gpu,test]'.
#
# .wheels/base is what the library needs, .wheels/part-N at most 40 MiB of a yardstick's wheel (cuFINUFFT's are large);
# these parts need not come at once: they are collected in $PARTS (default: /tmp/gpu-session-parts) until all are there.
set -euo pipefail
cd "$(dirname "$0")/.."

out=${OUT:-gpu-session} wheels=${WHEELS:-.wheels} parts=${PARTS:-/tmp/gpu-session-parts}
site=${SITE:-/tmp/gpu-session-site} # what is not installed, for this session alone
python=${PYTHON:-python3}
# What the library needs besides what such machines have (NumPy, SciPy, Numba, CuPy, numba-cuda, typer, rich, pytest);
# others to be compared with come last.
needed=(annotated-types cbor2 cobs filelock google-crc32c pydantic pydantic-core pyserial typing-inspection typing-extensions
    rich typer shellingham annotated-doc pytest-timeout)
# PATminton's and cuFINUFFT's wheels want the libraries of CUDA 12, of which the smallest serve
cuda12=(nvidia-cuda-runtime-cu12==12.1.105 nvidia-cufft-cu12==11.0.2.54)
peers=(patminton "${cuda12[0]}" cufinufft==2.4.1 "${cuda12[1]}" cufinufft)

fetch() {
    mkdir -p "$wheels/base" "$wheels/whole"
    local from=(--quiet --only-binary=:all: --python-version "${PYTHON_VERSION:-3.12}" --implementation cp)
    for tag in manylinux_2_28 manylinux_2_27 manylinux_2_17 manylinux2014 manylinux1 manylinux_2_34; do
        from+=(--platform "${tag}_x86_64")
    done
    # pydantic names the very version of its core
    "$python" -m pip download --no-deps "${from[@]}" -d "$wheels/base" "${needed[@]}" "$(core)"
    local number=1 filled=0 size
    for peer in "${peers[@]}"; do
        "$python" -m pip download --no-deps "${from[@]}" -d "$wheels/whole" "$peer"
        wheel=$(find "$wheels/whole" -name '*.whl')
        split -b 10M -d --additional-suffix=.part "$wheel" "$wheel."
        for part in "$wheel".*.part; do
            size=$(stat -c %s "$part")
            if [ $((filled + size)) -gt $((40 << 20)) ]; then
                number=$((number + 1)) filled=0
            fi
            filled=$((filled + size))
            mkdir -p "$wheels/part-$number"
            mv "$part" "$wheels/part-$number"
        done
        stat -c %s "$wheel" >"$wheels/part-$number/$(basename "$wheel").size" # the last one says how much it is in all
        rm "$wheel"
    done
    rmdir "$wheels/whole"
    du -h "$wheels"/*
    ls "$wheels"/part-*
}

collect() {
    mkdir -p "$parts"
    cp "$wheels"/part-*/* "$parts" 2>/dev/null || true
}

core() {
    "$python" -m pip download --quiet --no-deps --only-binary=:all: -d "$wheels/base" pydantic
    unzip -p "$(find "$wheels/base" -name 'pydantic-*.whl')" '*/METADATA' | sed -n 's/^Requires-Dist: \(pydantic.core==[^;]*\).*/\1/p'
}

# provide: PYTHONPATH has the library, and what came along in wheels.
provide() {
    mkdir -p "$out"
    if [ -z "${CUDA_HOME:-}" ] && [ -d /usr/local/cuda ]; then
        export CUDA_HOME=/usr/local/cuda # where numba-cuda looks for NVVM if no package has it
    fi
    export PYTHONPATH="$PWD/service:$PWD/driver:$PWD/benchmarks" NUMBA_CACHE_DIR=${NUMBA_CACHE_DIR:-/tmp/gpu-session-numba}
    if [ -n "${PYTHON:-}" ]; then
        : # has all
    elif collect && [ -d "$wheels" ]; then
        # an older one of what the machine has would hide it: only what cannot be imported is installed
        local missing=()
        for wheel in "$wheels"/base/*.whl; do
            name=$(basename "$wheel" | cut -d- -f1)
            "$python" -c "import importlib.metadata as m; m.version('$name')" 2>/dev/null || missing+=("$wheel")
        done
        if [ ${#missing[@]} -gt 0 ]; then
            "$python" -m pip install --quiet --no-index --no-deps --no-compile --upgrade --target "$site" "${missing[@]}"
        fi
        export PYTHONPATH="$PYTHONPATH:$site"
    else
        [ -d .gpu-venv ] || python3 -m venv .gpu-venv
        .gpu-venv/bin/pip install --quiet '.[gpu,test]'
        python=$PWD/.gpu-venv/bin/python
    fi
    {
        nvidia-smi || true
        "$python" -c '
import platform
from importlib.metadata import PackageNotFoundError, version
print("python", platform.python_version())
for name in ("numpy", "scipy", "numba", "numba-cuda", "cupy-cuda13x", "cupy-cuda12x", "torch", "pydantic"):
    try:
        print(name, version(name))
    except PackageNotFoundError:
        pass
from steradian.imaging.engines.cuda.array_backend import device
backend = device()
print("device:", backend.name, backend.free(), "bytes free")
'
    } 2>&1 | tee "$out/machine.txt"
}

# peer PATTERN: the folder that a yardstick is installed in, once all parts of its wheel are there; nothing before.
peer() {
    local size wheel to="$site-$1"
    for size in "$parts"/$1*.whl.size; do
        [ -f "$size" ] || return 0
        wheel=${size%.size}
        cat "$wheel".*.part >"$wheel"
        [ "$(stat -c %s "$wheel")" = "$(cat "$size")" ] || return 0
        [ -d "$to" ] || "$python" -m pip install --quiet --no-index --no-deps --no-compile --target "$to" "$wheel" >&2
        echo "$to"
        return 0
    done
}

tests() {
    # by themselves: the conftests further up ask for what only the service needs
    "$python" -m pytest -o addopts= -o filterwarnings=default --import-mode=importlib -p no:cacheprovider \
        --confcutdir=tests/service/imaging -q -ra --durations=15 "$@" tests/service/imaging/test_cuda_engine.py \
        tests/service/imaging/test_device.py tests/service/imaging/test_gpu_arrays.py tests/service/imaging/test_gpu.py \
        tests/service/imaging/test_parametric.py \
        2>&1 | tee "$out/tests.log"
}

benchmark() {
    local others=$PYTHONPATH found cufft
    cufft=$(peer nvidia_cufft_cu12)
    for found in "$(peer nvidia_cuda_runtime_cu12)" "$cufft"; do
        [ -z "$found" ] || LD_LIBRARY_PATH="${LD_LIBRARY_PATH:+$LD_LIBRARY_PATH:}$(find "$found/nvidia" -type d -name lib)"
    done
    export LD_LIBRARY_PATH=${LD_LIBRARY_PATH:-}
    found=$(peer patminton-)
    if [ -n "$found" ]; then
        [ -n "$cufft" ] || build_patminton "$found"
        others="$others:$found"
    fi
    found=$(peer cufinufft-2.4)
    [ -z "$found" ] || others="$others:$found"
    PYTHONPATH=$others run_benchmark gpu "$@" || status=1
    cp docs/performance.md "$out"
    "$python" -m steradian_benchmarks gpu --figures "$out/gpu.json" --page "$out/performance.md" || status=1
    found=$(peer cufinufft-2.5)
    if [ -n "$found" ]; then
        PYTHONPATH="$PYTHONPATH:$found" run_benchmark gpu-cufinufft --only cuFINUFFT || status=1
    fi
}

run_benchmark() { # FILE [OPTION…]
    local file=$1
    shift
    COLUMNS=180 "$python" -m steradian_benchmarks gpu --json "$out/$file.json" "$@" \
        2>&1 | tee "$out/$file.log"
}

# build_patminton FOLDER: its library for this machine's CUDA, from the sources that its wheel has; that of the wheel
# wants another major version of cuFFT than the machine may have.
build_patminton() {
    command -v nvcc >/dev/null || return 0
    local source="$1/patminton/cuda" stub=()
    nvcc --version | grep -q 'release 1[3-9]' && stub=(-static-global-template-stub=false)
    if nvcc -shared -Xcompiler -fPIC -arch=native "${stub[@]}" -I"$source/include" -o "$1/patminton/libpat_gpu.so.new" \
        "$source"/src/*.cu "$source/libpat.cu" -lcufft >"$out/patminton-build.log" 2>&1; then
        mv "$1/patminton/libpat_gpu.so.new" "$1/patminton/libpat_gpu.so"
    else
        echo "PATminton was not built ($out/patminton-build.log); its own library is tried"
    fi
}

status=0
case "${1:-all}" in
    fetch) fetch ;;
    collect) collect && ls -l "$parts" ;;
    tests) provide && tests "${@:2}" ;;
    benchmark) provide && benchmark "${@:2}" ;;
    all) provide && { tests || status=1; } && benchmark ;;
    *) sed -n 's/^# \{0,1\}//p' "$0" | sed -n 2,16p && exit 2 ;;
esac
exit $status
