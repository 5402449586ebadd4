# A router with pnet-nat's package, for the commands of one page. Called in namespaces of its own:
#
#   machine.sh FOLDER PAGE PROGRAMS
#
# FOLDER has the page's commands (page.sh) and takes what they write; PROGRAMS has pnet-nat. The Internet is
# at wan0, the plant at plant0. What the machine really has in /etc and /var/lib stays as it is.

set -euo pipefail
folder=$1 page=$2
export PATH="$folder/bin:$3:/usr/sbin:/sbin:$PATH" HOME="$folder/home"
mkdir -p "$folder"/{bin,home,etc,lib,units,run}

cp -a /etc/. "$folder/etc"
mount --bind "$folder/etc" /etc
mount --bind "$folder/lib" /var/lib
mount -t tmpfs tmpfs /run
mkdir -p /lib/systemd/system
cp deploy/systemd/pnet-nat.service "$folder/units"
mount --bind "$folder/units" /lib/systemd/system
mkdir -p /etc/systemd/system /etc/grafana /var/lib/grafana /etc/sysctl.d
install -D -m 644 config/pnet-nat.toml /etc/pnet-nat/pnet-nat.toml
install -d -m 700 /etc/pnet-nat/secrets

# Stands in for systemd's: starts and reloads what the units say.
cat >"$folder/bin/systemctl" <<'END'
#!/bin/bash
set -euo pipefail
verb=$1 unit=${!#}
file=/etc/systemd/system/$unit.service
[ -e "$file" ] || file=/lib/systemd/system/$unit.service
run=${0%/bin/*}/run/$unit
property() { sed -n "s#^$1=/usr/bin/##p" "$file"; }
stop() { # and wait until its ports are free
    [ ! -e "$run.pid" ] || { kill "$(cat "$run.pid")" && tail --pid="$(cat "$run.pid")" -f /dev/null; }
}
start() {
    mkdir -p "/run/$unit" # RuntimeDirectory
    for _ in $(seq 15); do
        : >"$run.log"
        # shellcheck disable=SC2046
        RUNTIME_DIRECTORY=/run/$unit setsid $(property ExecStart) >"$run.log" 2>&1 </dev/null &
        echo $! >"$run.pid"
        for _ in $(seq 100); do
            ! grep -q '"message":"relaying"' "$run.log" || return 0
            kill -0 "$(cat "$run.pid")" 2>/dev/null || break
            sleep 0.1
        done
        sleep 1 # RestartSec
    done
    cat "$run.log" >&2
    return 1
}
case $verb in
daemon-reload) ;;
enable | start) start ;;
stop) stop ;;
restart) stop && start ;;
# shellcheck disable=SC2046
reload) RUNTIME_DIRECTORY=/run/$unit $(property ExecReload) ;;
*) echo "systemctl $verb: not known here" >&2 && exit 1 ;;
esac
END
chmod +x "$folder/bin/systemctl"

# The far ends of the cables: a gateway on the Internet, and a plant without nodes.
unshare --net sleep infinity &
outside=$!
disown # no job of the page's
until [ "$(readlink "/proc/$outside/ns/net")" != "$(readlink /proc/self/ns/net)" ]; do sleep 0.05; done
there() { nsenter --net="/proc/$outside/ns/net" "$@"; }
ip link set lo up
ip link add wan0 type veth peer name wan netns "$outside"
ip link add plant0 type veth peer name plant netns "$outside"
ip link set wan0 up
ip link set plant0 up
ip addr add 203.0.113.5/24 dev wan0
ip addr add 172.17.17.250/24 dev plant0
ip route add default via 203.0.113.1
there ip link set wan up
there ip link set plant up
there ip addr add 203.0.113.1/24 dev wan

# What a router has from before: Debian's firewall, and a map of the kernel's own.
nft -f - <<'END'
table inet filter {
    chain input { type filter hook input priority filter; }
    chain output { type filter hook output priority filter; }
}
table ip plant_nat {
    chain prerouting {
        type nat hook prerouting priority dstnat;
        udp dport 20101 dnat to 172.17.17.1:34379
    }
}
END

# All pages but the README begin with a service that was set up as the README has it.
if [ "$page" != README.md ]; then
    sed -i '/^\[\[server\]\]/,/^# ── Bounds/{/^# ── Bounds/!d}' /etc/pnet-nat/pnet-nat.toml
    pnet-nat password /etc/pnet-nat/secrets/section-1
    systemctl enable --now pnet-nat
fi

# Between two blocks a reader takes a moment, in which what was started becomes ready, or ends.
settle() {
    for _ in $(seq 100); do
        [ -n "$(jobs -rp)" ] || return 0
        ! pnet-nat healthcheck 2>/dev/null || return 0
        sleep 0.1
    done
}

. "$folder/page.sh"
