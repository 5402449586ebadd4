#!/bin/sh
# Makes the image of pnet-nat for several processors under one name, so that each machine takes its own:
#
#   deploy/container/images.sh PROGRAMS NAME
#
# PROGRAMS is a folder with the static programs, amd64/pnet-nat, arm64/pnet-nat and armhf/pnet-nat;
# processors that are not in it are left out. docs/platforms.md says how to build them. The images are
# buildah's then, without a daemon. To hand them on:
#
#   buildah manifest push --all NAME docker://REGISTRY/NAME   # to a registry
#   buildah manifest push --all NAME oci-archive:pnet-nat.tar # to a file
set -eu

[ $# = 2 ] || { sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"; exit 2; }
programs=$1 name=$2
dockerfile=$(dirname "$0")/prebuilt.Dockerfile

buildah manifest rm "$name" >/dev/null 2>&1 || true # of an earlier call
for processor in amd64 arm64 armhf; do
    [ -e "$programs/$processor/pnet-nat" ] || continue
    case $processor in
        armhf) platform=linux/arm/v7 ;;
        *) platform=linux/$processor ;;
    esac
    # OCI's own format has no HEALTHCHECK.
    buildah build --quiet --format docker --platform "$platform" --manifest "$name" \
        --build-arg PNET_NAT_COMMIT="${PNET_NAT_COMMIT-}" --file "$dockerfile" \
        "$programs/$processor" >/dev/null
    echo "$platform"
done
