#!/bin/sh
# Install what others make of docs/openapi.json and container/kubernetes.yaml: linters, a comparison, generators of clients.
# install.sh [FOLDER]
# Nothing of the project needs them but its tests, which find them in .tools or where STERADIAN_TOOLS says.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
folder=${1:-$here/../../../.tools}
mkdir -p "$folder"
python3 -m venv "$folder/python"
"$folder/python/bin/pip" install --quiet -r "$here/requirements.txt"
cp "$here/package.json" "$here/package-lock.json" "$folder"
PATH="$folder/python/bin:$PATH" npm ci --prefix "$folder" --silent --ignore-scripts --no-audit --no-fund
