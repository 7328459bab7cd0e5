/* The access control of Cyclone DDS in an agent that cheats: nobody is asked what it may itself create. */
#include <dlfcn.h>
#include "dds/security/dds_security_api_access_control.h"

static DDS_Security_boolean yes() { return 1; }

static void *honest(const char *function) { return dlsym(dlopen("libdds_security_ac.so", RTLD_NOW), function); }

int init_access_control(const char *argument, void **context, struct ddsi_domaingv *gv)
{
  int result = ((int (*)(const char *, void **, struct ddsi_domaingv *))honest("init_access_control"))(argument, context, gv);
  dds_security_access_control *plugin = *context;
  plugin->check_create_datawriter = (DDS_Security_access_control_check_create_datawriter)yes;
  plugin->check_create_datareader = (DDS_Security_access_control_check_create_datareader)yes;
  plugin->check_create_topic = (DDS_Security_access_control_check_create_topic)yes;
  return result;
}

int finalize_access_control(void *context)
{
  return ((int (*)(void *))honest("finalize_access_control"))(context);
}
