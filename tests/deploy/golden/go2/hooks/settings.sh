# shellcheck shell=bash
# What the hooks know of this agent. Written by sfglab from the fleet file: change it there.

export SFGLAB_AGENT=go2
export SFGLAB_FOLDER=/opt/sfglab/go2
export SFGLAB_SERVICE=sfglab-go2.service
export SFGLAB_STATE=/var/lib/sfglab/go2
export SFGLAB_GID=10001
export SFGLAB_GLOBAL_INTERFACE=wlan0
export SFGLAB_TIME_SERVERS=workstation.local
export SFGLAB_SERVES_TIME=no
export SFGLAB_FIREWALL=yes
export SFGLAB_FIREWALL_LEFT_OUT=''
export SFGLAB_TABLE=sfglab_go2
