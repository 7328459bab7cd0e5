/* A peer in domain 0: publishes its name, says what it hears, sees and is refused, until its input ends.
 * peer NAME [pub TOPIC | sub TOPIC]... */
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include "String.h"
#include "dds/dds.h"

static void tell(dds_entity_t reader, const char *topic, const dds_guid_t *own)
{
  void *sample = NULL;
  dds_sample_info_t info;
  for (; dds_take(reader, &sample, &info, 1, 1) > 0; dds_return_loan(reader, &sample, 1)) {
    if (info.valid_data && topic)
      printf("heard %s %s\n", topic, ((std_msgs_msg_dds__String_ *)sample)->data);
    else if (info.valid_data && memcmp(&((dds_builtintopic_endpoint_t *)sample)->participant_key, own, sizeof *own))
      printf("saw %s\n", ((dds_builtintopic_endpoint_t *)sample)->topic_name);
  }
}

int main(int argc, char **argv)
{
  setvbuf(stdout, NULL, _IOLBF, 0);
  dds_entity_t made[16], participant = dds_create_participant(0, NULL, NULL);
  if (participant < 0) return 1;
  dds_guid_t own;
  dds_get_guid(participant, &own);
  dds_entity_t graph = dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, NULL, NULL);
  std_msgs_msg_dds__String_ text = {.data = argv[1]};
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  for (int i = 2; i + 1 < argc && i < 16; i += 2) {
    dds_entity_t topic = dds_create_topic(participant, &std_msgs_msg_dds__String__desc, argv[i + 1], NULL, NULL);
    made[i] = (*argv[i] == 'p' ? dds_create_writer : dds_create_reader)(participant, topic, qos, NULL);
    if (made[i] < 0) printf("refused %s %s\n", argv[i], argv[i + 1]);
  }
  for (struct pollfd input = {.events = POLLIN}; poll(&input, 1, 50) == 0; tell(graph, NULL, &own))
    for (int i = 2; i + 1 < argc && i < 16; i += 2)
      if (made[i] > 0 && *argv[i] == 'p') dds_write(made[i], &text);
      else if (made[i] > 0) tell(made[i], argv[i + 1], &own);
  dds_delete_qos(qos);
  return dds_delete(participant) < 0;
}
