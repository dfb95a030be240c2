// Preloaded into a daemon (LD_PRELOAD), it lets that daemon alone, with its driver hosts, believe that its machine is
// not well. The file that CHAOS_MACHINE_FILE names holds two numbers of 16 bytes, as text, which may change at any
// time:
//
// How many seconds the time of the day is ahead. Clocks that only count are left alone. A wait until a time of the day
// gets the machine's time back, because the kernel knows nothing of this.
//
// 1 while the disk with the folder CHAOS_DISK is broken: writing to its files fails with EIO.
#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>

#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <unistd.h>

namespace {

constexpr std::size_t width = 16;                  // of a number
constexpr std::time_t of_the_day = 1'000'000'000;  // no clock that counts from the start of a machine is that far

const char* open_file() {
  const char* file = std::getenv("CHAOS_MACHINE_FILE");
  const int descriptor = file == nullptr ? -1 : ::open(file, O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return nullptr;
  void* text = ::mmap(nullptr, 2 * width, PROT_READ, MAP_SHARED, descriptor, 0);
  ::close(descriptor);
  return text == MAP_FAILED ? nullptr : static_cast<const char*>(text);
}

long number(std::size_t which) {
  static const char* const text = open_file();
  return text == nullptr ? 0 : std::strtol(text + which * width, nullptr, 10);
}

std::time_t ahead() {
  return static_cast<std::time_t>(number(0));
}

/// Whether the descriptor is of a file on a broken disk; sets errno then.
bool broken(int descriptor) {
  static const char* const folder = std::getenv("CHAOS_DISK");
  if (folder == nullptr || number(1) == 0) return false;
  char link[32];
  char path[4096];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
  const ssize_t length = ::readlink(link, path, sizeof path);
  const std::size_t prefix = std::strlen(folder);
  if (length < static_cast<ssize_t>(prefix) || std::strncmp(path, folder, prefix) != 0) return false;
  errno = EIO;
  return true;
}

template <typename Function>
Function* next(const char* name, const char* version) {
  void* found = ::dlvsym(RTLD_NEXT, name, version);
  return reinterpret_cast<Function*>(found != nullptr ? found : ::dlsym(RTLD_NEXT, name));
}

timespec machines(const timespec* until) {
  timespec real = *until;
  if (real.tv_sec > of_the_day) real.tv_sec -= ahead();
  return real;
}

}  // namespace

extern "C" {

int clock_gettime(clockid_t clock, timespec* time) {
  static auto* const real = next<int(clockid_t, timespec*)>("clock_gettime", "GLIBC_2.17");
  const int result = real(clock, time);
  if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) time->tv_sec += ahead();
  return result;
}

int gettimeofday(timeval* time, void*) {
  timespec now;
  const int result = clock_gettime(CLOCK_REALTIME, &now);
  *time = {now.tv_sec, now.tv_nsec / 1000};
  return result;
}

std::time_t time(std::time_t* time) {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (time != nullptr) *time = now.tv_sec;
  return now.tv_sec;
}

int pthread_cond_timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex, const timespec* until) {
  static auto* const real =
      next<int(pthread_cond_t*, pthread_mutex_t*, const timespec*)>("pthread_cond_timedwait", "GLIBC_2.3.2");
  const timespec moment = machines(until);
  return real(condition, mutex, &moment);
}

int pthread_cond_clockwait(pthread_cond_t* condition, pthread_mutex_t* mutex, clockid_t clock, const timespec* until) {
  static auto* const real =
      next<int(pthread_cond_t*, pthread_mutex_t*, clockid_t, const timespec*)>("pthread_cond_clockwait", "GLIBC_2.34");
  const timespec moment = clock == CLOCK_REALTIME ? machines(until) : *until;
  return real(condition, mutex, clock, &moment);
}

int pthread_mutex_timedlock(pthread_mutex_t* mutex, const timespec* until) {
  static auto* const real = next<int(pthread_mutex_t*, const timespec*)>("pthread_mutex_timedlock", "GLIBC_2.34");
  const timespec moment = machines(until);
  return real(mutex, &moment);
}

int sem_timedwait(sem_t* semaphore, const timespec* until) {
  static auto* const real = next<int(sem_t*, const timespec*)>("sem_timedwait", "GLIBC_2.34");
  const timespec moment = machines(until);
  return real(semaphore, &moment);
}

int clock_nanosleep(clockid_t clock, int flags, const timespec* until, timespec* left) {
  static auto* const real = next<int(clockid_t, int, const timespec*, timespec*)>("clock_nanosleep", "GLIBC_2.17");
  const timespec moment = clock == CLOCK_REALTIME && (flags & TIMER_ABSTIME) != 0 ? machines(until) : *until;
  return real(clock, flags, &moment, left);
}

ssize_t write(int descriptor, const void* bytes, std::size_t count) {
  static auto* const real = next<ssize_t(int, const void*, std::size_t)>("write", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, bytes, count);
}

ssize_t writev(int descriptor, const iovec* parts, int count) {
  static auto* const real = next<ssize_t(int, const iovec*, int)>("writev", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, parts, count);
}

ssize_t pwrite(int descriptor, const void* bytes, std::size_t count, off_t offset) {
  static auto* const real = next<ssize_t(int, const void*, std::size_t, off_t)>("pwrite", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, bytes, count, offset);
}

ssize_t pwritev(int descriptor, const iovec* parts, int count, off_t offset) {
  static auto* const real = next<ssize_t(int, const iovec*, int, off_t)>("pwritev", "GLIBC_2.10");
  return broken(descriptor) ? -1 : real(descriptor, parts, count, offset);
}

int ftruncate(int descriptor, off_t length) {
  static auto* const real = next<int(int, off_t)>("ftruncate", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, length);
}

// The names under which programs that were compiled for large files call the same.
ssize_t pwrite64(int descriptor, const void* bytes, std::size_t count, off_t offset) {
  return pwrite(descriptor, bytes, count, offset);
}

ssize_t pwritev64(int descriptor, const iovec* parts, int count, off_t offset) {
  return pwritev(descriptor, parts, count, offset);
}

ssize_t pwritev64v2(int descriptor, const iovec* parts, int count, off_t offset, int) {
  return pwritev(descriptor, parts, count, offset);
}

int ftruncate64(int descriptor, off_t length) {
  return ftruncate(descriptor, length);
}

int fsync(int descriptor) {
  static auto* const real = next<int(int)>("fsync", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor);
}

int fdatasync(int descriptor) {
  static auto* const real = next<int(int)>("fdatasync", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor);
}

}  // extern "C"
