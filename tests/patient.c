// Preloaded into ranks that share processors: one that waits for a message sleeps for a moment instead of asking again
// at once. Where more run than there are processors, asking takes the time of those that are waited for.
#include <time.h>

int sched_yield(void) {
  struct timespec moment = {0, 20000};
  return nanosleep(&moment, 0);
}
