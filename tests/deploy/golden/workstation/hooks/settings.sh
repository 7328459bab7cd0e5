# shellcheck shell=bash
# What the hooks know of this agent. Written by sfglab from the fleet file: change it there.

export SFGLAB_AGENT=workstation
export SFGLAB_FOLDER=/opt/sfglab/workstation
export SFGLAB_SERVICE=sfglab-workstation.service
export SFGLAB_STATE=/var/lib/sfglab/workstation
export SFGLAB_GID=10001
export SFGLAB_GLOBAL_INTERFACE=eth0
export SFGLAB_TIME_SERVERS=''
export SFGLAB_SERVES_TIME=yes
export SFGLAB_FIREWALL=yes
export SFGLAB_FIREWALL_LEFT_OUT=''
export SFGLAB_TABLE=sfglab_workstation
