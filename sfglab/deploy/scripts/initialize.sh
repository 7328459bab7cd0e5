#!/bin/bash
# Makes this machine ready for the agent: synchronised time, firewall, systemd service.
#
#   sudo hooks/initialize.sh             do it; a second run finds nothing to do
#   sudo hooks/initialize.sh --dry-run   change nothing, show what would change
#   sudo hooks/initialize.sh --undo      take back what the hooks have done
#   hooks/initialize.sh --development    as VS Code runs it: without root, only what the containers need to start
#   SFGLAB_ROOT=/mnt/image hooks/initialize.sh   do it to another root; nothing that runs is touched
#
# Runs the scripts NN-*.sh beside it in the order of their names, then yours: custom.d/*.sh, see
# custom.d/README. Says one line per thing: unchanged, would change, changed or skipped. The first thing that
# cannot be done ends it with one sentence and a status other than zero; run again, it goes on from there.

set -euo pipefail

usage() {
    printf 'usage: %s [--dry-run] [--undo] [--development]\n' "${0##*/}"
}

action=apply
development=0
for argument in "$@"; do
    case $argument in
    --dry-run) export SFGLAB_DRY_RUN=1 ;;
    --undo) action=undo ;;
    --development) development=1 ;;
    -h | --help)
        usage
        exit 0
        ;;
    *)
        printf "sfglab: given '%s', allowed: --dry-run, --undo, --development\n" "$argument" >&2
        exit 2
        ;;
    esac
done

# shellcheck source=lib.sh disable=SC1091
. "$(dirname -- "${BASH_SOURCE[0]}")/lib.sh"
if [ "$development" = 1 ] && [ -z "$SFGLAB_ROOT" ] && [ "$(id -u)" != 0 ]; then
    bash "$SFGLAB_HOOKS/30-service.sh" environment
    report skipped 'time, firewall and service' 'they need root: sudo hooks/initialize.sh, once'
    exit
fi
check_rights

hooks=("$SFGLAB_HOOKS"/[0-9][0-9]-*.sh)
if [ "$action" = undo ]; then
    for ((last = ${#hooks[@]} - 1; last >= 0; last--)); do
        bash "${hooks[last]}" undo
    done
    dry || rmdir -- "$SFGLAB_ROOT$SFGLAB_STATE" 2>/dev/null || :
else
    for hook in "${hooks[@]}"; do
        bash "$hook" apply
    done
fi

for script in "$SFGLAB_HOOKS"/custom.d/*.sh; do
    [ -f "$script" ] || continue
    name=custom.d/${script##*/}
    if [ "$action" = undo ]; then
        report skipped "$name" 'what scripts of yours have done is yours to take back'
    elif dry; then
        report skipped "$name" 'scripts of yours are not run by --dry-run'
    else
        bash "$script" || fail "$name: has failed with status $?"
        report ran "$name"
    fi
done
