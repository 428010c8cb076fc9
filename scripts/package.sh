#!/usr/bin/env bash
# A release: a tarball and a Debian package in target/packages, with the program, man pages, completions and examples. Who installs
# them needs no compiler. Needs `cargo install cargo-deb`, dpkg-dev; `--try` installs the package in a bare Debian (mmdebstrap, as
# root) and runs it there. HYDROGRAD_PROFILE=release takes a build that is there already; a release is built with `dist`.
set -euo pipefail
cd "$(dirname "$0")/.."
profile=${HYDROGRAD_PROFILE:-dist}
for tool in cargo-deb dpkg-shlibdeps; do
    command -v "$tool" >/dev/null || { echo "package.sh: $tool is not installed: cargo install cargo-deb; apt-get install dpkg-dev" >&2; exit 2; }
done
target=${CARGO_TARGET_DIR:-target}
out=target/packages
[ "$profile" = release ] && [ -x "$target/release/hydrograd" ] || cargo build --profile "$profile"
program=$target/$profile/hydrograd
version=$("$program" --version | cut -d' ' -f2)
machine=$(uname -m)
stage=$out/stage
rm -rf "$stage"
mkdir -p "$stage"/{man,completions,examples}
cp "$program" "$stage/hydrograd"
strip "$stage/hydrograd"
"$program" man "$stage/man" >/dev/null
gzip -9nf "$stage"/man/*.1
"$program" completions bash >"$stage/completions/hydrograd.bash"
"$program" completions zsh >"$stage/completions/_hydrograd"
"$program" completions fish >"$stage/completions/hydrograd.fish"
cp data/scenes/examples/*.toml "$stage/examples"
for scene in $("$program" scenes | sed -n 's/^  \([a-z0-9-]*\)  .*/\1/p' | head -3); do
    "$program" scenes "$scene" >"$stage/examples/$scene.toml" 2>/dev/null || rm -f "$stage/examples/$scene.toml"
done
cp README.md LICENSE src/cli/CHANGES.md "$stage"
tarball=$out/hydrograd-$version-$machine-linux.tar.gz
tar -C "$out" --transform "s,^stage,hydrograd-$version," --owner 0 --group 0 -czf "$tarball" stage
rm -f "$out"/*.deb
# What goes where stands in Cargo.toml.
cargo deb --no-build --no-strip --profile "$profile" --output "$out"
ls -l "$tarball" "$out"/*.deb
[ "${1:-}" = --try ] || exit 0
command -v mmdebstrap >/dev/null || { echo "package.sh: mmdebstrap is not installed: apt-get install mmdebstrap" >&2; exit 2; }
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
chmod 755 "$root"
package=$(realpath "$out"/*.deb)
echo "== a bare Debian"
mmdebstrap --variant=minbase --customize-hook="copy-in $package /root" \
    --customize-hook='chroot "$1" sh -c "apt-get install -y /root/*.deb"' bookworm "$root" 2>&1 | tail -3
echo "== in it"
chroot "$root" bash -c '
    set -e
    cd /root
    ! command -v cc && ! command -v cargo
    hydrograd --version
    time hydrograd optimize --out wall
    test -s wall/summary.json && ls wall
    hydrograd simulate /usr/share/doc/hydrograd/examples/hot-block.toml --set time.end=0.2 --out block | tail -3
    test -s /usr/share/man/man1/hydrograd-optimize.1.gz'
