# shellcheck shell=bash
# What the hooks know of this agent. Written by sfglab from the fleet file: change it there.

export SFGLAB_AGENT={{ agent | sh }}
export SFGLAB_FOLDER={{ folder | sh }}
export SFGLAB_SERVICE={{ service | sh }}
export SFGLAB_STATE={{ state | sh }}
export SFGLAB_GID={{ gid | sh }}
export SFGLAB_GLOBAL_INTERFACE={{ interface | sh }}
export SFGLAB_TIME_SERVERS={{ servers | join(" ") | sh }}
export SFGLAB_SERVES_TIME={{ "yes" if serves else "no" }}
export SFGLAB_FIREWALL={{ "yes" if firewall else "no" }}
export SFGLAB_FIREWALL_LEFT_OUT={{ left_out | sh }}
export SFGLAB_TABLE={{ table | sh }}
