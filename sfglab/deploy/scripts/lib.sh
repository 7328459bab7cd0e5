# shellcheck shell=bash
# What all hooks share. Sourced by them, and by scripts of yours in custom.d/ that want the same helpers:
#
#   report WORD WHAT [WHY]           say one line: unchanged, would change, changed or skipped
#   fail SENTENCE                    say what cannot be done, and stop
#   put_file PATH MODE TEXT [TASK]   have a file with this text; written beside its place, then renamed
#   put_link PATH TARGET [TASK]      have a symbolic link
#   drop_path PATH [TASK]            have no file or link there
#   settle TASK WHAT COMMAND...      run a command of the running system if TASK is still owed
#
# PATH is a path on the machine; SFGLAB_ROOT, if set, is put before it. A TASK is remembered in
# /var/lib/sfglab until its command has run, so that a run that was cut short is made good by the next.
# With SFGLAB_DRY_RUN=1 nothing is changed: differences are shown instead.

set -euo pipefail
umask 022
PATH="$PATH:/usr/sbin:/sbin"
SFGLAB_HOOKS=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)
SFGLAB_ROOT=${SFGLAB_ROOT:-}
SFGLAB_ROOT=${SFGLAB_ROOT%/}
SFGLAB_DRY_RUN=${SFGLAB_DRY_RUN:-0}
export PATH SFGLAB_HOOKS SFGLAB_ROOT SFGLAB_DRY_RUN
# shellcheck source=settings.sh disable=SC1091
. "$SFGLAB_HOOKS/settings.sh"

declare -A SFGLAB_OWED=()

report() {
    printf '%s: %s%s\n' "$1" "$2" "${3:+ ($3)}"
}

fail() {
    printf 'sfglab: %s\n' "$1" >&2
    exit 1
}

dry() {
    [ "$SFGLAB_DRY_RUN" = 1 ]
}

changes() {
    if dry; then
        report 'would change' "$@"
    else
        report changed "$@"
    fi
}

# A program of the machine, or of the other root: is it installed?
installed() {
    local folder
    if [ -z "$SFGLAB_ROOT" ]; then
        command -v "$1" >/dev/null
        return
    fi
    for folder in /usr/sbin /usr/bin /sbin /bin; do
        [ ! -x "$SFGLAB_ROOT$folder/$1" ] || return 0
    done
    return 1
}

check_rights() {
    if [ -n "$SFGLAB_ROOT" ]; then
        case $SFGLAB_ROOT in
        /*) ;;
        *) fail "SFGLAB_ROOT: given '$SFGLAB_ROOT', allowed: the absolute path of a folder" ;;
        esac
        [ -d "$SFGLAB_ROOT" ] || fail "SFGLAB_ROOT: given '$SFGLAB_ROOT', which is no folder"
    elif [ "$(id -u)" != 0 ]; then
        fail "the machine can be changed by root only: run it with sudo, or set SFGLAB_ROOT to another root"
    fi
}

# A link inside another root may lead out of it, to this machine's own files.
check_inside() {
    local root folder
    [ -n "$SFGLAB_ROOT" ] || return 0
    root=$(readlink -m -- "$SFGLAB_ROOT")
    folder=$(readlink -m -- "$(dirname -- "$SFGLAB_ROOT$1")")
    case $folder/ in
    "$root"/*) ;;
    *) fail "$1: leads out of SFGLAB_ROOT to $folder" ;;
    esac
}

# Owed for this run; owe also remembers it for the next.
want() {
    SFGLAB_OWED[$1]=1
}

owe() {
    [ -n "$1" ] || return 0
    want "$1"
    if ! dry && [ -z "$SFGLAB_ROOT" ]; then
        mkdir -p -- "$SFGLAB_STATE" || fail "$SFGLAB_STATE: cannot be made"
        : >"$SFGLAB_STATE/$1" || fail "$SFGLAB_STATE/$1: cannot be written"
    fi
}

put_file() {
    local path=$1 mode=$2 text=$3 task=${4:-} place=$SFGLAB_ROOT$1 old=/dev/null
    check_inside "$path"
    [ ! -d "$place" ] || fail "$path: is a folder, where a file belongs"
    if [ -f "$place" ] && [ ! -L "$place" ]; then
        old=$place
        if printf '%s\n' "$text" | cmp -s -- - "$place" && [ "$(stat -c %a -- "$place")" = "$mode" ]; then
            report unchanged "$path"
            return
        fi
    fi
    owe "$task"
    changes "$path"
    if dry; then
        printf '%s\n' "$text" | diff -u -L "$path" -L "$path" -- "$old" - || :
        return
    fi
    mkdir -p -- "$(dirname -- "$place")" || fail "$path: its folder cannot be made"
    # A fixed name: what a run leaves that was cut short here, the next one takes up. No daemon reads it.
    printf '%s\n' "$text" >"$place.sfglab-new" || fail "$path: cannot be written"
    chmod "$mode" "$place.sfglab-new"
    sync -- "$place.sfglab-new" || :
    mv -fT -- "$place.sfglab-new" "$place" || fail "$path: cannot be replaced"
}

put_link() {
    local path=$1 target=$2 task=${3:-} place=$SFGLAB_ROOT$1
    check_inside "$path"
    if [ -L "$place" ] && [ "$(readlink -- "$place")" = "$target" ]; then
        report unchanged "$path"
        return
    fi
    owe "$task"
    changes "$path" "a link to $target"
    dry && return
    mkdir -p -- "$(dirname -- "$place")" || fail "$path: its folder cannot be made"
    ln -sfn -- "$target" "$place.sfglab-new" || fail "$path: cannot be written"
    mv -fT -- "$place.sfglab-new" "$place" || fail "$path: cannot be replaced"
}

drop_path() {
    local path=$1 task=${2:-} place=$SFGLAB_ROOT$1
    check_inside "$path"
    if [ ! -e "$place" ] && [ ! -L "$place" ]; then
        report unchanged "$path" 'there is none'
        return
    fi
    owe "$task"
    changes "$path" 'removed'
    dry || rm -f -- "$place" "$place.sfglab-new" || fail "$path: cannot be removed"
}

settle() {
    local task=$1 what=$2
    shift 2
    if [ -n "$SFGLAB_ROOT" ]; then
        report skipped "$what" 'SFGLAB_ROOT is not the running system'
    elif [ -z "${SFGLAB_OWED[$task]:-}" ] && [ ! -e "$SFGLAB_STATE/$task" ]; then
        report unchanged "$what"
    elif dry; then
        changes "$what"
    else
        "$@" || fail "$what: '$*' has failed"
        rm -f -- "$SFGLAB_STATE/$task"
        changes "$what"
    fi
}

# The same for a command of systemd, which does not run in every container.
settle_systemd() {
    local task=$1 what=$2
    if [ -z "$SFGLAB_ROOT" ] && [ ! -d /run/systemd/system ]; then
        report skipped "$what" 'systemd does not run here'
        dry || rm -f -- "$SFGLAB_STATE/$task"
        return
    fi
    settle "$@"
}
