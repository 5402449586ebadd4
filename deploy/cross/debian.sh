#!/bin/sh
# Runs a command in a Debian that has Rust and a linker for other processors, with this repository as
# the working folder:
#
#   deploy/cross/debian.sh cargo build --profile dist --target armv7-unknown-linux-gnueabihf
#
# The first call makes that Debian: 3 GB in a folder of its own, PNET_NAT_CROSS or
# ~/.cache/pnet-nat/cross. Needs root and mmdebstrap. What is built is static, so it runs on any
# Linux of its processor. Build output is in target/cross, by target. Ends with 75 where Debian's
# packages cannot be reached.
set -eu

repository=$(cd "$(dirname "$0")/../.." && pwd)
debian=${PNET_NAT_CROSS:-${XDG_CACHE_HOME:-$HOME/.cache}/pnet-nat/cross}
cargo_home=${CARGO_HOME:-$HOME/.cargo}

recipe=$repository/deploy/cross/make-debian.sh

[ $# -gt 0 ] || { sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"; exit 2; }
# Another recipe makes another Debian.
cmp -s "$recipe" "$debian/made-by" || "$recipe" "$debian" >&2

# Crates are fetched by this machine's cargo, which knows how to reach them.
[ "$1" != cargo ] || (cd "$repository" && cargo fetch --quiet --locked)

# The mounts end with the command.
exec unshare --mount --propagation private sh -euc '
    debian=$1 repository=$2 cargo_home=$3
    shift 3
    mkdir -p "$debian/pnet-nat" "$debian/cargo"
    mount --bind "$repository" "$debian/pnet-nat"
    mount --bind "$cargo_home" "$debian/cargo"
    mount --rbind /dev "$debian/dev"
    mount -t proc proc "$debian/proc"
    static="-C target-feature=+crt-static ${PNET_NAT_CROSS_FLAGS-}"
    # On 32-bit ARM, GNU ld makes static programs of more than 16 MB of code that crash at their start.
    lld="-C link-arg=-fuse-ld=lld"
    exec chroot "$debian" env --ignore-environment --chdir=/pnet-nat \
        PATH=/usr/bin:/bin HOME=/root TERM=dumb \
        CARGO_HOME=/cargo CARGO_NET_OFFLINE=true CARGO_TARGET_DIR=target/cross CARGO_INCREMENTAL=0 \
        PNET_NAT_COMMIT="${PNET_NAT_COMMIT-}" CARGO_PROFILE_DEV_DEBUG="${CARGO_PROFILE_DEV_DEBUG-1}" \
        CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUSTFLAGS="$static" \
        CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUSTFLAGS="$static" \
        CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
        CARGO_TARGET_ARMV7_UNKNOWN_LINUX_GNUEABIHF_RUSTFLAGS="$static $lld" \
        CARGO_TARGET_ARMV7_UNKNOWN_LINUX_GNUEABIHF_LINKER=arm-linux-gnueabihf-gcc \
        CARGO_TARGET_S390X_UNKNOWN_LINUX_GNU_RUSTFLAGS="$static" \
        CARGO_TARGET_S390X_UNKNOWN_LINUX_GNU_LINKER=s390x-linux-gnu-gcc \
        "$@"
' sh "$debian" "$repository" "$cargo_home" "$@"
