#!/bin/bash
# Other processors: the program compiles for them without a warning, is packed as Debian packages and images,
# and runs on real kernels of theirs, in machines that qemu plays: confined, with flows in the kernel, at work.
#
# Needs root and the packages buildah, busybox-static, mmdebstrap, qemu-system-arm and qemu-system-misc, and
# cargo-deb. Compilers and kernels are Debian's; it ends with 75 where they cannot be reached. Without
# arguments it takes all processors; arguments name some: arm64 armhf s390x. With the word `compile` before them it
# compiles, and that is all.
set -euo pipefail
cd "$(dirname "$0")/../.."

declare -A TARGETS=(
    [arm64]=aarch64-unknown-linux-gnu [armhf]=armv7-unknown-linux-gnueabihf [s390x]=s390x-unknown-linux-gnu)
declare -A KERNELS=([arm64]=arm64 [armhf]=armmp [s390x]=s390x)
declare -A MACHINES=(
    [arm64]="qemu-system-aarch64 -machine virt -cpu cortex-a53"
    [armhf]="qemu-system-arm -machine virt,highmem=off -cpu cortex-a7"
    # With vector instructions, checksums of ICMP come out wrong in this machine.
    [s390x]="qemu-system-s390x -machine s390-ccw-virtio -cpu qemu,vx=off,vxeh=off")
declare -A CONSOLES=([arm64]=ttyAMA0 [armhf]=ttyAMA0 [s390x]=ttysclp0)

compile_only=
if [ "${1-}" = compile ]; then
    compile_only=yes
    shift
fi
processors=("$@")
# Those with unit tests first: their machines work longest.
[ $# -gt 0 ] || processors=(armhf s390x arm64)
work=$PWD/target/processors
mkdir -p "$work"

debian() {
    deploy/cross/debian.sh "$@"
}

# Whether the unit tests are run on this processor: where numbers are shorter or octets stand in another order,
# and where somebody asks for this processor alone. 64-bit ARM is as x86-64 in both.
has_units() {
    [ "$1" != arm64 ] || [ "${processors[*]}" = arm64 ]
}

# The program, its unit tests, and what tries the confinement.
compile() {
    local processor=$1 target=${TARGETS[$1]} log=$work/$1/compiler units=()
    mkdir -p "$work/$processor"
    ! has_units "$processor" || units=(--lib)
    # The linker warns of names that static programs look up; nothing here looks up a name of a host.
    # Without what debuggers read, it is a third of the octets.
    PNET_NAT_CROSS_FLAGS="-A linker-messages" CARGO_PROFILE_DEV_DEBUG=0 debian env CARGO_BUILD_WARNINGS=deny \
        cargo test --no-run --locked --target "$target" "${units[@]}" --test violations 2>"$log" ||
        { local code=$?; cat "$log"; return $code; }
}

# Where a test of this name was compiled to.
compiled() {
    sed -n "s|^ *Executable .*$2 (\(.*\))$|\1|p" "$work/$1/compiler"
}

# The Debian package, with the program of the tests as that of the package's profile.
package() {
    local processor=$1 target=${TARGETS[$1]}
    mkdir -p "target/cross/$target/dist"
    ln -sf ../debug/pnet-nat "target/cross/$target/dist/pnet-nat"
    CARGO_TARGET_DIR=target/cross cargo deb --quiet --no-build --no-strip --fast --locked --offline \
        --target "$target" --output "$work/$processor/pnet-nat.deb"
    [ "$(dpkg-deb --field "$work/$processor/pnet-nat.deb" Architecture)" = "$processor" ]
    rm -rf "$work/$processor/package"
    dpkg-deb --extract "$work/$processor/pnet-nat.deb" "$work/$processor/package"
}

# The kernel of a processor and a busybox, from Debian's packages. The Debian of the compilers keeps them.
fetch() {
    local processor=$1
    mkdir -p "$work/$processor"
    debian sh -euc '
        processor=$1 kernel=$2 work=$3 kept=/var/cache/pnet-nat/$1
        depends() { apt-cache depends "$1" | sed -n "s/^ *Depends: \($2.*\)/\1/p"; }
        if [ ! -e "$kept/vmlinuz" ]; then
            rm -rf "$kept" && mkdir -p "$kept" && cd "$kept"
            apt-get update -qq || exit 75
            # A metapackage names the image, and that the package of the kernel itself.
            binary=$(depends "$(depends "linux-image-$kernel:$processor" linux-image-)" linux-binary-)
            apt-get download -qq "$binary" "busybox-static:$processor" || exit 75
            for package in *.deb; do dpkg-deb --extract "$package" packages; done
            mv packages/usr/bin/busybox packages/usr/lib/modules/*/vmlinuz .
            rm -r packages ./*.deb
        fi
        cp "$kept"/* "/pnet-nat/$work"
    ' sh "$processor" "${KERNELS[$processor]}" "target/processors/$processor"
}

# The files of a machine: the first process, busybox, the program of the package, and what is to be tried.
pack() {
    local processor=$1 root=$work/$1/root
    rm -rf "$root" && mkdir -p "$root"/{bin,dev,etc,pnet-nat,proc,sys,tmp}
    cp tests/processors/init "$root/init"
    cp "$work/$processor/busybox" "$work/$processor/package/usr/bin/pnet-nat" "$root/bin"
    ln -s busybox "$root/bin/sh"
    ! has_units "$processor" || cp "$(compiled "$processor" lib.rs)" "$root/bin/unit-tests"
    # On s390x there is no filter of system calls to be tried; its test is compiled because cargo then builds
    # the program, too.
    [ "$processor" = s390x ] || cp "$(compiled "$processor" violations.rs)" "$root/bin/violations"
    # What unit tests read; they were compiled in a folder of this name.
    cp -r --parents fuzz/corpus/offload src/config/tests/snapshots "$root/pnet-nat"
    (cd "$root" && find . | busybox cpio -o -H newc) >"$work/$processor/initramfs"
}

boot() {
    local processor=$1
    # shellcheck disable=SC2086 # words
    exec timeout 2400 ${MACHINES[$processor]} -smp 2 -m 1024 -nographic -no-reboot -nodefaults -serial stdio \
        -kernel "$work/$processor/vmlinuz" -initrd "$work/$processor/initramfs" \
        -append "console=${CONSOLES[$processor]} quiet panic=-1" </dev/null >"$work/$processor/console"
}

judge() {
    local processor=$1 console=$work/$1/console tries good
    tr -d '\r' <"$console" >"$console.text" && mv "$console.text" "$console"
    cat "$console"
    tries=$(grep -c '^== ' "$console")
    good=$(grep -c '^== .*: good$' "$console")
    echo "$processor: $good of $tries tries are good"
    grep -q '^all was tried$' "$console" && [ "$good" = "$tries" ]
}

# One image for all processors, each with its own program.
images() {
    local name=localhost/pnet-nat-test programs=$work/programs processor
    rm -rf "$programs"
    install -D target/debug/pnet-nat "$programs/amd64/pnet-nat"
    for processor in "${processors[@]}"; do
        install -D "$work/$processor/package/usr/bin/pnet-nat" "$programs/$processor/pnet-nat"
    done
    # A store of its own, which needs no file system of its own. Nothing runs in the images.
    export BUILDAH_ISOLATION=chroot CONTAINERS_STORAGE_CONF=$work/storage.conf
    printf '[storage]\ndriver = "vfs"\ngraphroot = "%s"\nrunroot = "%s"\n' "$work/store" "$work/store-run" \
        >"$CONTAINERS_STORAGE_CONF"
    deploy/container/images.sh "$programs" "$name"
    buildah manifest inspect "$name" >"$work/manifest"
    buildah rmi --all --force >/dev/null
    for processor in amd64 "${processors[@]}"; do
        [ "$processor" = s390x ] || grep -q "\"architecture\": \"${processor/armhf/arm}\"" "$work/manifest"
    done
}

if [ "$compile_only" ]; then
    for processor in "${processors[@]}"; do
        compile "$processor"
    done
    exit
fi

mkdir -p target/package
cargo run --quiet --locked -- man target/package
for shell in bash:pnet-nat.bash zsh:_pnet-nat fish:pnet-nat.fish; do
    cargo run --quiet --locked -- completions "${shell%:*}" >"target/package/${shell#*:}"
done
# A machine works while the next one's program is compiled.
declare -A machines
trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
for processor in "${processors[@]}"; do
    for step in compile fetch package pack; do
        echo "-- $processor: $step"
        $step "$processor"
    done
    boot "$processor" &
    machines[$processor]=$!
done
echo "-- images"
images
for processor in "${processors[@]}"; do
    echo "-- $processor: boot"
    wait "${machines[$processor]}" || echo "the machine did not end by itself"
    judge "$processor"
done
