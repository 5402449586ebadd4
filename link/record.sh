#!/usr/bin/env bash
# Records which functions a relay uses, from its start to its end, and writes them to
# link/relay-first.ld. The linker then puts them side by side at the beginning of the program.
#
# The kernel keeps a program in memory by pieces of 64 kB. Where the functions of a relay stand
# between those of decode, inventory and all other commands, it keeps nearly the whole program.
#
# Compilers and libraries name their functions differently. So the programs of two are recorded: that of this
# machine's cargo, and that of deploy/cross. What the script names and a program lacks does no harm.
#
# Needs root, valgrind, what deploy/cross/debian.sh needs, and a quarter of an hour. Run it when tests/it finds
# that a relay takes too much memory.
set -euo pipefail
cd "$(dirname "$0")/.."

target=x86_64-unknown-linux-gnu
build=(env CARGO_PROFILE_DIST_STRIP=none cargo build --profile dist --locked --target $target)
CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUSTFLAGS="-C target-feature=+crt-static" CARGO_TARGET_DIR=target/link \
    "${build[@]}"
deploy/cross/debian.sh "${build[@]}"

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

# The names of the functions that a relay of this program calls.
record() {
    local program=$1
    "$program" node --listen 127.62.12.1-5 --password-file "$folder/password" >"$folder/node" &
    local node=$!
    valgrind --quiet --tool=callgrind --demangle=no --callgrind-out-file="$folder/calls" \
        "$program" run --config "$folder/pnet-nat.toml" &
    local relay=$!
    get /-/ready --retry 60 --retry-connrefused --retry-delay 1
    ask password --count 20 --interval 100ms --timeout 5s
    ask another || true
    get /metrics
    get /metrics --header "Accept-Encoding: gzip"
    get /api/v1/status
    kill -HUP $relay
    sleep 12 # the report of dropped datagrams, and a step of the history
    ask password --timeout 5s
    kill -TERM $relay $node
    wait $relay $node
    sed -n "s/^c\{0,1\}fn=([0-9]*) \([^' ]*\).*/\1/p" "$folder/calls" >"$folder/called"
    # The compiler merges functions that do the same; the section may have the name of any of them.
    nm "$program" | awk '
        NR == FNR { called[$1]; next }
        { place[FNR] = $1; name[FNR] = $3 }
        $3 in called { used[$1] }
        END { for (i in name) if (place[i] in used) print name[i] }' "$folder/called" -
}
ask() {
    "$program" request --to 127.0.0.1 --start-port 26000 --node 1-5 --password-file "$folder/$1" "${@:2}" >&2
}
get() { curl --silent --show-error --output "$folder/answer" "http://127.0.0.1:26378$1" "${@:2}"; }

record "target/link/$target/dist/pnet-nat" >"$folder/names"
record "target/cross/$target/dist/pnet-nat" >>"$folder/names"

# A function of libc has no section of its own; its object file has one.
members='nm -A --defined-only "$(cc -print-file-name=libc.a)" 2>/dev/null'
{ sh -c "$members" && deploy/cross/debian.sh sh -c "$members"; } |
    sed -n 's/^[^:]*:\([^:]*\):[0-9a-f]* [TtWwi] \(.*\)/\2 \1/p' | LC_ALL=C sort -u >"$folder/members"
{
    cat <<END
/* Made by link/record.sh, which says what it is for: the functions that a relay uses. */
SECTIONS { .text.relay_first : {
/* A hash in a name stands for the version of a compiler or crate: any is right. And what drops a value is
   called drop_in_place or drop_glue. */
END
    grep '^_R' "$folder/names" |
        sed -E 's/\.llvm\..*//; s/Cs[0-9A-Za-z]+_/Cs*_/g; s/(13drop_in_place|9drop_glue)/*drop_*/' |
        sed -E 's/^(.{150}).+/\1/; s/$/*/; s/\*\*/*/g' | LC_ALL=C sort -u | sed 's/.*/*(.text*.&)/'
    echo "/* Those of libc, by object file. Of libm, all that there are: it has few. */"
    grep -v '^_[ZR]' "$folder/names" | LC_ALL=C sort -u | LC_ALL=C join - "$folder/members" | cut -d ' ' -f 2 |
        LC_ALL=C sort -u | sed 's/.*/*libc.a:&(.text .text.*)/'
    echo '*libm*.a:*(.text .text.*)'
    echo '*(.text.main)'
    echo "} } INSERT BEFORE .text;"
} >link/relay-first.ld
echo "link/relay-first.ld: $(grep -c '^\*' link/relay-first.ld) patterns"
