#!/usr/bin/env bash
# Records which functions a relay uses, from its start to its end, and writes them to
# link/relay-first.ld. The linker then puts them side by side at the beginning of the program.
#
# The kernel keeps a program in memory by pieces of 64 kB. Where the functions of a relay stand
# between those of decode, inventory and all other commands, it keeps nearly the whole program.
#
# Needs valgrind, and some minutes. Run it when tests/it finds that a relay takes too much memory.
set -euo pipefail
cd "$(dirname "$0")/.."

target=x86_64-unknown-linux-gnu
CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUSTFLAGS="-C target-feature=+crt-static" CARGO_PROFILE_DIST_STRIP=none \
    CARGO_TARGET_DIR=target/link cargo build --profile dist --locked --target $target
program=$PWD/target/link/$target/dist/pnet-nat

folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -r "$folder"' EXIT
printf 'rec#rd-8' >"$folder/password"
printf 'anot#er1' >"$folder/another"
chmod 600 "$folder"/*
cat >"$folder/pnet-nat.toml" <<END
[public]
listen = ["127.0.0.1"]
[[udp_range_net]]
name = "section-1"
start_port = 26000
subnet = "127.62.12.0"
nodes = ["1-5"]
allow = ["127.0.0.0/8"]
[[udp_range_net.password]]
name = "maintenance"
file = "$folder/password"
[admin]
listen = "127.0.0.1:26378"
[runtime]
workers = 1
END

"$program" node --listen 127.62.12.1-5 --password-file "$folder/password" &
valgrind --quiet --tool=callgrind --demangle=no --callgrind-out-file="$folder/calls" \
    "$program" run --config "$folder/pnet-nat.toml" &
relay=$!
ask() {
    "$program" request --to 127.0.0.1 --start-port 26000 --node 1-5 --password-file "$folder/$1" "${@:2}"
}
get() { curl --silent --show-error --output "$folder/answer" "http://127.0.0.1:26378$1" "${@:2}"; }
curl --silent --output "$folder/answer" --retry 60 --retry-connrefused --retry-delay 1 \
    http://127.0.0.1:26378/-/ready
ask password --count 20 --interval 100ms --timeout 5s
ask another || true
get /metrics
get /metrics --header "Accept-Encoding: gzip"
get /api/v1/status
kill -HUP $relay
sleep 12 # the report of dropped datagrams, and a step of the history
ask password --timeout 5s
kill -TERM $relay
wait $relay

# A function of libc has no section of its own; its object file has one.
libc=$(cc -print-file-name=libc.a)
{
    cat <<END
/* Made by link/record.sh, which says what it is for: the functions that a relay uses. */
SECTIONS { .text.relay_first : {
/* A hash in a name stands for the version of a compiler or crate: any is right. */
END
    sed -n 's/^c\{0,1\}fn=([0-9]*) \(_R[^'\'' ]*\).*/\1/p' "$folder/calls" |
        sed -E 's/\.llvm\..*//; s/Cs[0-9A-Za-z]+_/Cs*_/g; s/^(.{150}).+/\1/; s/$/*/' |
        LC_ALL=C sort -u | sed 's/.*/*(.text*.&)/'
    echo "/* Those of libc, by object file. */"
    nm -A --defined-only "$libc" 2>/dev/null |
        sed -n 's/^[^:]*:\([^:]*\):[0-9a-f]* [TtWwi] \(.*\)/\2 \1/p' | LC_ALL=C sort -u >"$folder/members"
    sed -n 's/^c\{0,1\}fn=([0-9]*) \([^'\'' ]*\).*/\1/p' "$folder/calls" | grep -v '^_[ZR]' | LC_ALL=C sort -u |
        LC_ALL=C join - "$folder/members" | cut -d ' ' -f 2 | LC_ALL=C sort -u |
        sed 's/.*/*libc.a:&(.text .text.*)/'
    echo "} } INSERT BEFORE .text;"
} >link/relay-first.ld
echo "link/relay-first.ld: $(grep -c '^\*' link/relay-first.ld) patterns"
