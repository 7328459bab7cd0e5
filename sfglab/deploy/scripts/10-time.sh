#!/bin/bash
# Has this machine take its time from the fleet's time servers (NTP), because latencies and transforms are
# compared across machines. Writes one file of settings of its own: for chrony if it is installed, else for
# systemd-timesyncd. Your own settings stay.
#
# The machine that the fleet file names as a time server also serves its time, with chrony, to the network of
# the global interface only; without any source of its own it goes on by its own clock (stratum 10).
#
# To change it: time_servers in the fleet file. To add to it: a script of yours in custom.d/.

# shellcheck source=lib.sh disable=SC1091
. "$(dirname -- "${BASH_SOURCE[0]}")/lib.sh"
check_rights

TIMESYNCD=/etc/systemd/timesyncd.conf.d/sfglab.conf
SETTINGS=(/etc/chrony/conf.d/sfglab.conf /etc/chrony.d/sfglab.conf "$TIMESYNCD")
SERVERS=()
read -r -a SERVERS <<<"$SFGLAB_TIME_SERVERS" || :

# Debian calls the service chrony, others chronyd.
chrony_unit() {
    local folder
    for folder in /usr/lib/systemd/system /lib/systemd/system; do
        if [ -e "$SFGLAB_ROOT$folder/chrony.service" ]; then
            echo chrony.service
            return
        fi
    done
    echo chronyd.service
}

chrony_file() {
    local folder
    for folder in /etc/chrony/conf.d /etc/chrony.d; do
        if [ -d "$SFGLAB_ROOT$folder" ]; then
            echo "$folder/sfglab.conf"
            return
        fi
    done
    fail "chrony: has neither /etc/chrony/conf.d nor /etc/chrony.d; make the one that its chrony.conf names"
}

# The networks of the global interface, as the running system has them.
networks() {
    local family
    if [ -n "$SFGLAB_ROOT" ] || [ -z "$SFGLAB_GLOBAL_INTERFACE" ] || ! command -v ip >/dev/null; then
        return 0
    fi
    for family in -4 -6; do
        ip "$family" -o route show dev "$SFGLAB_GLOBAL_INTERFACE" proto kernel 2>/dev/null |
            awk '$1 ~ /\// && $1 !~ /^(fe80|ff00):/ { print $1 }' | sort -u || :
    done
}

chrony_text() {
    local server network
    echo '# Written by sfglab: the time servers of the fleet.'
    for server in "${SERVERS[@]}"; do
        echo "server $server iburst prefer"
    done
    if [ "$SFGLAB_SERVES_TIME" = yes ]; then
        echo 'local stratum 10'
        for network in $(networks); do
            echo "allow $network"
        done
    fi
}

say_who_is_served() {
    [ "$SFGLAB_SERVES_TIME" = yes ] || return 0
    if [ -z "$SFGLAB_GLOBAL_INTERFACE" ]; then
        report skipped 'serving time' 'the fleet file names no global interface'
    elif [ -n "$SFGLAB_ROOT" ]; then
        report skipped 'serving time' "the network of $SFGLAB_GLOBAL_INTERFACE is known on the running system"
    elif [ -z "$(networks)" ]; then
        report skipped 'serving time' "$SFGLAB_GLOBAL_INTERFACE has no network yet: run it again when it has"
    fi
}

restart_time() {
    systemctl enable --quiet "$1" && systemctl restart "$1"
}

with_chrony() {
    local path
    path=$(chrony_file)
    put_file "$path" 644 "$(chrony_text)" time
    say_who_is_served
    settle_systemd time 'restart of chrony' restart_time "$(chrony_unit)"
}

with_timesyncd() {
    if [ "$SFGLAB_SERVES_TIME" = yes ]; then
        report skipped 'serving time' 'systemd-timesyncd cannot: install chrony'
    fi
    if [ "${#SERVERS[@]}" = 0 ]; then
        report skipped 'time servers' 'this machine is the only one'
        forget
        return
    fi
    # The empty assignment forgets other servers: the whole fleet goes by the same clocks.
    put_file "$TIMESYNCD" 644 "# Written by sfglab: the time servers of the fleet.
[Time]
NTP=
NTP=${SERVERS[*]}" time
    settle_systemd time 'restart of systemd-timesyncd' restart_time systemd-timesyncd.service
}

has_timesyncd() {
    [ -x "$SFGLAB_ROOT/usr/lib/systemd/systemd-timesyncd" ] || [ -x "$SFGLAB_ROOT/lib/systemd/systemd-timesyncd" ]
}

apply() {
    if [ "${#SERVERS[@]}" = 0 ] && [ "$SFGLAB_SERVES_TIME" != yes ]; then
        report skipped 'time servers' 'the fleet file names none'
        forget
    elif installed chronyd; then
        with_chrony
    elif has_timesyncd; then
        with_timesyncd
    else
        report skipped 'time servers' 'neither chrony nor systemd-timesyncd is installed: install chrony'
    fi
}

set_before() {
    local path
    for path in "${SETTINGS[@]}"; do
        [ ! -e "$SFGLAB_ROOT$path" ] || return 0
    done
    return 1
}

# What an earlier release has set.
forget() {
    if set_before; then
        undo
    fi
}

undo() {
    local path
    if ! set_before; then
        report unchanged 'time servers' 'none were set'
    fi
    for path in "${SETTINGS[@]}"; do
        [ ! -e "$SFGLAB_ROOT$path" ] || drop_path "$path" time
    done
    if installed chronyd; then
        settle_systemd time 'restart of chrony' systemctl try-restart "$(chrony_unit)"
    else
        settle_systemd time 'restart of systemd-timesyncd' systemctl try-restart systemd-timesyncd.service
    fi
}

case ${1:-apply} in
apply | undo) "${1:-apply}" ;;
*) fail "10-time.sh: given '$1', allowed: apply, undo" ;;
esac
