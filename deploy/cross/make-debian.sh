#!/bin/sh
# Makes a Debian sid that has Rust and a linker for other processors in a folder, for debian.sh.
set -eu

debian=$1
echo "making a Debian with compilers in $debian; this takes some minutes"
rm -rf "$debian"
mkdir -p "$(dirname "$debian")"
# A mirror may lag behind; its signature is checked all the same.
mmdebstrap --quiet --variant=apt --architectures=amd64,arm64,armhf,s390x \
    --aptopt='Acquire::Check-Valid-Until "false"' --aptopt='APT::Sandbox::User "root"' \
    --keyring=/usr/share/keyrings/debian-archive-keyring.gpg \
    --include=cargo,rustc,gcc,libc6-dev,lld \
    --include=gcc-aarch64-linux-gnu,libc6-dev-arm64-cross \
    --include=gcc-arm-linux-gnueabihf,libc6-dev-armhf-cross \
    --include=gcc-s390x-linux-gnu,libc6-dev-s390x-cross \
    sid "$debian" ${PNET_NAT_CROSS_MIRROR-} || exit 75
# Of Rust's packages for other processors the standard library alone: they cannot be installed together.
chroot "$debian" sh -euc '
    mkdir /tmp/rust && cd /tmp/rust
    apt-get update -qq
    apt-get download -qq libstd-rust-dev:arm64 libstd-rust-dev:armhf libstd-rust-dev:s390x
    for package in *.deb; do
        dpkg-deb --fsys-tarfile "$package" | tar -x -C / ./usr/lib/rustlib
    done
    rm -r /tmp/rust' || exit 75
cp "$0" "$debian/made-by"
