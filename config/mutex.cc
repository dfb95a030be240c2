#include <iotcloud/config/mutex.h>

#if defined(__GLIBCXX__) && !defined(_GLIBCXX_USE_PTHREAD_COND_CLOCKWAIT)
#error "waits on the steady clock would go by the wall clock here: glibc 2.30 or newer is needed"
#endif

namespace iotcloud::config {

std::cv_status Clock::wait_until(ConditionVariable& changed, Mutex& mutex, Instant end) const {
  const Instant before = now();
  if (before >= end) return std::cv_status::timeout;
  changed.wait_for(mutex, end - before);
  return now() < end ? std::cv_status::no_timeout : std::cv_status::timeout;
}

}  // namespace iotcloud::config
