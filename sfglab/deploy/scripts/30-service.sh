#!/bin/bash
# Installs the agent's systemd service, so that its containers start with the machine, and writes .env, which
# Compose reads: the release, and numbers that only this machine knows, the groups of its graphics devices.
# It does not start the service: systemctl start does, or the next start of the machine.
#
# To change the service, do not edit it, for the next run writes it again: systemctl edit makes a drop-in that
# stays. A service that was masked stays masked.

# shellcheck source=lib.sh disable=SC1091
. "$(dirname -- "${BASH_SOURCE[0]}")/lib.sh"
[ "${1:-}" = environment ] || check_rights

UNIT=/etc/systemd/system/$SFGLAB_SERVICE
WANTED=/etc/systemd/system/multi-user.target.wants/$SFGLAB_SERVICE
# Beside compose.yaml, which on a developer's machine may be anywhere. In an installed release it is a link to
# a file outside of the release, which stays when the release changes.
COMPOSE_ENV=$(readlink -m -- "$SFGLAB_HOOKS/../.env")
if [ -n "$SFGLAB_ROOT" ]; then
    COMPOSE_ENV=${COMPOSE_ENV#"$(readlink -m -- "$SFGLAB_ROOT")"}
fi

group_number() {
    if [ -z "$SFGLAB_ROOT" ] && command -v getent >/dev/null; then
        getent group "$1" | cut -d: -f3 || :
    elif [ -r "$SFGLAB_ROOT/etc/group" ]; then
        awk -F: -v name="$1" '$1 == name { print $3; exit }' "$SFGLAB_ROOT/etc/group"
    fi
}

compose_env() {
    local group number lines release=$SFGLAB_HOOKS/../release.env
    [ -r "$release" ] || fail "release.env: missing, so that no release could start"
    lines='# Written by hooks/30-service.sh from release.env, with numbers of groups on this machine.'
    lines+=$'\n'$(<"$release")
    for group in video render; do
        number=$(group_number "$group")
        if [ -z "$number" ]; then
            number=$SFGLAB_GID
            report skipped "group $group" "this machine has none: $number, the containers' own, stands for it"
        fi
        lines+=$'\n'SFGLAB_${group^^}_GID=$number
    done
    put_file "$COMPOSE_ENV" 644 "$lines"
}

masked() {
    [ -L "$SFGLAB_ROOT$UNIT" ] && [ "$(readlink -- "$SFGLAB_ROOT$UNIT")" = /dev/null ]
}

apply() {
    compose_env
    if masked; then
        report skipped "$UNIT" "it is masked: systemctl unmask $SFGLAB_SERVICE"
        return
    fi
    put_file "$UNIT" 644 "$(<"$SFGLAB_HOOKS/../systemd/$SFGLAB_SERVICE")" service
    put_link "$WANTED" "$UNIT" service
    settle_systemd service 'reload of systemd' systemctl daemon-reload
}

undo() {
    if masked; then
        report skipped "$UNIT" 'it is masked'
    else
        if [ -e "$SFGLAB_ROOT$UNIT" ]; then
            owe stop
        fi
        settle_systemd stop "stop of $SFGLAB_SERVICE" systemctl stop "$SFGLAB_SERVICE"
        drop_path "$WANTED" service
        drop_path "$UNIT" service
        settle_systemd service 'reload of systemd' systemctl daemon-reload
    fi
    drop_path "$COMPOSE_ENV"
}

case ${1:-apply} in
apply | undo) "${1:-apply}" ;;
environment) compose_env ;;
*) fail "30-service.sh: given '$1', allowed: apply, undo, environment" ;;
esac
