"""What a machine needs beside containers: synchronised time, a firewall, and a service that starts them.

Paper A, section 4.4, "Lifecycle Hooks": the `initialize_command` and the user's extension scripts.
"""

from __future__ import annotations

from sfglab.deploy.host.bundle import HOOKS, Hook, host_files
from sfglab.deploy.host.firewall import firewall_left_out, firewall_rules, firewall_table
from sfglab.deploy.host.time_servers import TimePlan, plan_time
from sfglab.deploy.host.unit import project_name, service_unit
from sfglab.deploy.host.unit_check import check_unit

__all__ = [
    "HOOKS",
    "Hook",
    "TimePlan",
    "check_unit",
    "firewall_left_out",
    "firewall_rules",
    "firewall_table",
    "host_files",
    "plan_time",
    "project_name",
    "service_unit",
]
