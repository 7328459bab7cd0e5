#!/bin/bash
# Keeps the agent's own DDS domain on this machine: a table of its own for nftables (firewall.nft beside this
# script) drops the domain's UDP ports at the global interface, and whatever would be forwarded to or from the
# bridge of the agent's container. Rules of yours and of Docker are not touched.
#
# The service loads the table before it starts the containers; loading it again replaces it in one step.
#
# To add rules: a table of your own, loaded by a script of yours in custom.d/. An accept in this table cannot
# overrule a drop in another one: if your own rules drop by default, let the ports of the global domain in.

# shellcheck source=lib.sh disable=SC1091
. "$(dirname -- "${BASH_SOURCE[0]}")/lib.sh"
check_rights

INSTALLED=/etc/sfglab/$SFGLAB_AGENT.nft

loaded() {
    nft list table inet "$SFGLAB_TABLE" >/dev/null 2>&1
}

forget() {
    nft delete table inet "$SFGLAB_TABLE"
}

apply() {
    if [ -n "$SFGLAB_FIREWALL_LEFT_OUT" ]; then
        report skipped 'firewall of the domain' "$SFGLAB_FIREWALL_LEFT_OUT"
    fi
    if [ "$SFGLAB_FIREWALL" != yes ]; then
        report skipped 'firewall' 'there is nothing to close'
        # An earlier release may have closed something.
        [ ! -e "$SFGLAB_ROOT$INSTALLED" ] || undo
        return
    fi
    put_file "$INSTALLED" 644 "$(<"$SFGLAB_HOOKS/firewall.nft")" firewall
    if ! installed nft; then
        report skipped 'loading the firewall' 'nft is not installed: install nftables'
        return
    fi
    if [ -z "$SFGLAB_ROOT" ] && ! loaded; then
        want firewall
    fi
    settle firewall "table inet $SFGLAB_TABLE" nft -f "$INSTALLED"
}

# What the service asks for before it starts the containers.
load() {
    if [ ! -e "$SFGLAB_ROOT$INSTALLED" ]; then
        report skipped 'loading the firewall' 'this agent has none'
    elif ! installed nft; then
        report skipped 'loading the firewall' 'nft is not installed: install nftables'
    elif [ -n "$SFGLAB_ROOT" ]; then
        report skipped 'loading the firewall' 'SFGLAB_ROOT is not the running system'
    elif dry; then
        changes "table inet $SFGLAB_TABLE"
    else
        nft -f "$INSTALLED" || fail "table inet $SFGLAB_TABLE: 'nft -f $INSTALLED' has failed"
        changes "table inet $SFGLAB_TABLE"
    fi
}

undo() {
    drop_path "$INSTALLED"
    if [ -z "$SFGLAB_ROOT" ] && installed nft && loaded; then
        want firewall
    fi
    settle firewall "table inet $SFGLAB_TABLE" forget
}

case ${1:-apply} in
apply | load | undo) "${1:-apply}" ;;
*) fail "20-firewall.sh: given '$1', allowed: apply, load, undo" ;;
esac
