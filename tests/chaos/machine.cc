// Preloaded into a daemon (LD_PRELOAD), it lets that daemon alone, with its driver hosts, believe that its machine is
// not well. The file that CHAOS_MACHINE_FILE names holds two numbers of 16 bytes, as text, which may change at any
// time:
//
// How many seconds the time of the day is ahead. Clocks that only count are left alone. A wait until a time of the day
// gets the machine's time back, because the kernel knows nothing of this.
//
// 1 while the disk with the folder CHAOS_DISK is broken: with EIO fail reading from and writing to its files, making
// them with open(), and renaming and removing files and folders there, by the calls that our daemons use. Opening a
// file that is there succeeds, as on a disk of which the kernel remembers the folder. So does what no library can stand
// between: what the loader of libraries reads, and what glibc does inside of itself for fopen() and C++'s streams.
#include <cerrno>
#include <cstdarg>
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
#include <sys/stat.h>
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

/// The folder of the disk while it is broken; null: it is well.
const char* broken_disk() {
  static const char* const folder = std::getenv("CHAOS_DISK");
  return folder == nullptr || number(1) == 0 ? nullptr : folder;
}

/// Whether a path is on the broken disk; sets errno then.
bool on(const char* disk, const char* path) {
  const std::size_t prefix = std::strlen(disk);
  if (std::strncmp(path, disk, prefix) != 0 || (path[prefix] != '/' && path[prefix] != '\0')) return false;
  errno = EIO;
  return true;
}

/// Whether the descriptor is of a file on a broken disk; sets errno then.
bool broken(int descriptor) {
  const char* const disk = broken_disk();
  if (disk == nullptr) return false;
  const int before = errno;
  char link[32];
  char path[4096];
  std::snprintf(link, sizeof link, descriptor == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", descriptor);
  const ssize_t length = ::readlink(link, path, sizeof path - 1);
  errno = before;
  if (length < 0) return false;
  path[length] = '\0';
  return on(disk, path);
}

/// The same for a path, which may begin at the folder of the descriptor.
bool broken(int folder, const char* path) {
  const char* const disk = broken_disk();
  if (disk == nullptr) return false;
  return path[0] == '/' ? on(disk, path) : broken(folder);
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

/// Opens a file as `call` does. A file that may have to be made is not opened on a broken disk.
template <typename Call>
int opened(int folder, const char* path, int flags, va_list more, Call call) {
  const bool makes = (flags & O_CREAT) != 0 || (flags & O_TMPFILE) == O_TMPFILE;
  const mode_t mode = makes ? va_arg(more, mode_t) : 0;
  if (makes && broken(folder, path)) return -1;
  return call(mode);
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

ssize_t read(int descriptor, void* bytes, std::size_t count) {
  static auto* const real = next<ssize_t(int, void*, std::size_t)>("read", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, bytes, count);
}

ssize_t readv(int descriptor, const iovec* parts, int count) {
  static auto* const real = next<ssize_t(int, const iovec*, int)>("readv", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, parts, count);
}

ssize_t pread(int descriptor, void* bytes, std::size_t count, off_t offset) {
  static auto* const real = next<ssize_t(int, void*, std::size_t, off_t)>("pread", "GLIBC_2.2.5");
  return broken(descriptor) ? -1 : real(descriptor, bytes, count, offset);
}

ssize_t pread64(int descriptor, void* bytes, std::size_t count, off_t offset) {
  return pread(descriptor, bytes, count, offset);
}

int open(const char* path, int flags, ...) {
  static auto* const real = next<int(const char*, int, ...)>("open", "GLIBC_2.2.5");
  va_list more;
  va_start(more, flags);
  const int result = opened(AT_FDCWD, path, flags, more, [&](mode_t mode) { return real(path, flags, mode); });
  va_end(more);
  return result;
}

__attribute__((alias("open"))) int open64(const char* path, int flags, ...);

int openat(int folder, const char* path, int flags, ...) {
  static auto* const real = next<int(int, const char*, int, ...)>("openat", "GLIBC_2.4");
  va_list more;
  va_start(more, flags);
  const int result = opened(folder, path, flags, more, [&](mode_t mode) { return real(folder, path, flags, mode); });
  va_end(more);
  return result;
}

__attribute__((alias("openat"))) int openat64(int folder, const char* path, int flags, ...);

int rename(const char* from, const char* to) {
  static auto* const real = next<int(const char*, const char*)>("rename", "GLIBC_2.2.5");
  return broken(AT_FDCWD, from) || broken(AT_FDCWD, to) ? -1 : real(from, to);
}

int mkdir(const char* path, mode_t mode) {
  static auto* const real = next<int(const char*, mode_t)>("mkdir", "GLIBC_2.2.5");
  return broken(AT_FDCWD, path) ? -1 : real(path, mode);
}

int rmdir(const char* path) {
  static auto* const real = next<int(const char*)>("rmdir", "GLIBC_2.2.5");
  return broken(AT_FDCWD, path) ? -1 : real(path);
}

int unlink(const char* path) {
  static auto* const real = next<int(const char*)>("unlink", "GLIBC_2.2.5");
  return broken(AT_FDCWD, path) ? -1 : real(path);
}

int unlinkat(int folder, const char* path, int flags) {
  static auto* const real = next<int(int, const char*, int)>("unlinkat", "GLIBC_2.4");
  return broken(folder, path) ? -1 : real(folder, path, flags);
}

int remove(const char* path) {
  static auto* const real = next<int(const char*)>("remove", "GLIBC_2.2.5");
  return broken(AT_FDCWD, path) ? -1 : real(path);
}

}  // extern "C"
