#!/usr/bin/env bash
# CUDA's compiler and libraries for `--features cuda` where no CUDA toolkit is installed: NVIDIA's wheels of PyPI, in one folder.
#
#     scripts/cuda.sh cargo build --release --features cuda    sets it up (1.2 GB), once, and runs a command with it
#     scripts/cuda.sh target/release/hydrograd ...             what was built asks for CUDA's libraries when it starts
#     eval "$(scripts/cuda.sh)"                                sets the same in this shell
#
# The folder is target/cuda; HYDROGRAD_CUDA names another one. HYDROGRAD_CUDA_VERSION is 13.0 unless told otherwise: a driver runs no kernels of
# a compiler newer than itself (580 and later run 13.0; `nvidia-smi` shows up to which CUDA), and the wheels of 12 have no nvcc.
# CUDA_COMPUTE_CAP is 80 unless told otherwise: a driver makes of that what any GPU since then runs; what is built for 90 runs on 9.0 alone.
# Neither building nor starting needs a GPU or its driver. Needs x86-64 Linux, Python 3 with pip, g++ (NVCC_CCBIN names another compiler).
set -euo pipefail
case "${1:-}" in -h | --help) sed -n '2,11s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
folder=${HYDROGRAD_CUDA:-$(cd "$(dirname "$0")/.." && pwd)/target/cuda}
version=${HYDROGRAD_CUDA_VERSION:-13.0}
home=$folder/nvidia/cu${version%%.*}
if [ "$(cat "$folder/version" 2> /dev/null)" != "$version" ]; then
    python3 -m pip --version > /dev/null || { echo "cuda.sh: Python has no pip; apt-get install python3-pip" >&2; exit 2; }
    mkdir -p "$folder"
    folder=$(cd "$folder" && pwd) home=$folder/nvidia/cu${version%%.*}
    echo "cuda.sh: CUDA $version into $folder" >&2
    python3 -m pip --disable-pip-version-check install -q --upgrade --target "$folder" \
        "cuda-toolkit[nvcc,nvvm,crt,cccl,cudart,cublas,curand,nvrtc]==$version.*" >&2
    [ -x "$home/bin/nvcc" ] || { echo "cuda.sh: no nvcc in the wheels of CUDA $version" >&2; exit 1; }
    # What a toolkit has and the wheels have not: lib64, the names that a linker looks for, and something to link with for the driver's
    # own library, which comes with the driver: all its functions say that there is no device (CUDA_ERROR_NO_DEVICE).
    ln -sfn lib "$home/lib64"
    (cd "$home/lib" && for library in *.so.*; do ln -sf "$library" "${library%%.so.*}.so"; done)
    mkdir -p "$home/lib/stubs"
    {
        echo 'int cuGetErrorString(int code, const char **text) { return *text = "no NVIDIA driver here", 0; }'
        cc -E -P "$home/include/cuda.h" | grep -oE '\bcu[A-Z][A-Za-z0-9_]*\(' | tr -d '(' | sort -u | grep -v '^cuGetErrorString$' |
            sed 's/.*/int &(void) { return 100; }/'
    } | cc -x c -shared -fPIC -Wl,-soname,libcuda.so.1 -o "$home/lib/stubs/libcuda.so.1" -
    ln -sf libcuda.so.1 "$home/lib/stubs/libcuda.so"
    echo "$version" > "$folder/version"
fi
home=$(cd "$home" && pwd)
libraries=$home/lib
python3 -c 'import ctypes; ctypes.CDLL("libcuda.so.1")' 2> /dev/null || libraries=$libraries:$home/lib/stubs
set -- CUDA_HOME="$home" CUDA_PATH="$home" CUDA_COMPUTE_CAP="${CUDA_COMPUTE_CAP:-80}" PATH="$home/bin:$PATH" \
    LD_LIBRARY_PATH="$libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" "$@"
[ $# -gt 5 ] && exec env "$@"
printf 'export %q\n' "$@"
