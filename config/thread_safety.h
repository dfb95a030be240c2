#pragma once

/// \file
/// Clang's thread safety analysis (`-Wthread-safety`, which `./dev lint` runs) reads from these macros which
/// mutex guards what, and rejects code that accesses a guarded variable without its mutex. For other compilers they are
/// empty, and they generate no code. https://releases.llvm.org/14.0.0/tools/clang/docs/ThreadSafetyAnalysis.html
/// explains each.
///
/// The analysis knows the types of `mutex.h` and ThreadRole below. It does not know `std::mutex`: libstdc++ does not
/// annotate it.

#if defined(__clang__) && !defined(SWIG)
#define IOTCLOUD_THREAD_SAFETY_(x) __attribute__((x))
#else
#define IOTCLOUD_THREAD_SAFETY_(x)
#endif

/// A class whose objects can be held, such as a mutex; `name` appears in the warnings ("mutex").
#define IOTCLOUD_CAPABILITY(name) IOTCLOUD_THREAD_SAFETY_(capability(name))
/// A class whose constructor acquires a capability and whose destructor releases it.
#define IOTCLOUD_SCOPED_CAPABILITY IOTCLOUD_THREAD_SAFETY_(scoped_lockable)

/// A variable that only the holder of the mutex may access; PT_: a pointer of which this holds for the target.
#define IOTCLOUD_GUARDED_BY(mutex) IOTCLOUD_THREAD_SAFETY_(guarded_by(mutex))
#define IOTCLOUD_PT_GUARDED_BY(mutex) IOTCLOUD_THREAD_SAFETY_(pt_guarded_by(mutex))

/// A mutex that must be locked before (after) the named ones.
#define IOTCLOUD_ACQUIRED_BEFORE(...) IOTCLOUD_THREAD_SAFETY_(acquired_before(__VA_ARGS__))
#define IOTCLOUD_ACQUIRED_AFTER(...) IOTCLOUD_THREAD_SAFETY_(acquired_after(__VA_ARGS__))

/// A function whose caller holds the mutexes (shared: at least for reading), before and after the call.
#define IOTCLOUD_REQUIRES(...) IOTCLOUD_THREAD_SAFETY_(requires_capability(__VA_ARGS__))
#define IOTCLOUD_REQUIRES_SHARED(...) IOTCLOUD_THREAD_SAFETY_(requires_shared_capability(__VA_ARGS__))
/// A function whose caller does not hold the mutexes, because the function takes them or calls code that may.
#define IOTCLOUD_EXCLUDES(...) IOTCLOUD_THREAD_SAFETY_(locks_excluded(__VA_ARGS__))

/// A function that returns with the mutexes held, or no longer held. Without arguments: the object itself.
#define IOTCLOUD_ACQUIRE(...) IOTCLOUD_THREAD_SAFETY_(acquire_capability(__VA_ARGS__))
#define IOTCLOUD_ACQUIRE_SHARED(...) IOTCLOUD_THREAD_SAFETY_(acquire_shared_capability(__VA_ARGS__))
#define IOTCLOUD_RELEASE(...) IOTCLOUD_THREAD_SAFETY_(release_capability(__VA_ARGS__))
#define IOTCLOUD_RELEASE_SHARED(...) IOTCLOUD_THREAD_SAFETY_(release_shared_capability(__VA_ARGS__))
/// A function that has locked the mutex if it returns the value given first.
#define IOTCLOUD_TRY_ACQUIRE(...) IOTCLOUD_THREAD_SAFETY_(try_acquire_capability(__VA_ARGS__))

/// A function after whose call the analysis assumes that the mutex is held.
#define IOTCLOUD_ASSERT_CAPABILITY(mutex) IOTCLOUD_THREAD_SAFETY_(assert_capability(mutex))
#define IOTCLOUD_ASSERT_SHARED_CAPABILITY(mutex) IOTCLOUD_THREAD_SAFETY_(assert_shared_capability(mutex))
/// A function that returns a reference to the mutex.
#define IOTCLOUD_RETURN_CAPABILITY(mutex) IOTCLOUD_THREAD_SAFETY_(lock_returned(mutex))

/// The analysis skips the body of this function; a comment there says why the body is right.
#define IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS IOTCLOUD_THREAD_SAFETY_(no_thread_safety_analysis)

namespace iotcloud::config {

/// Represents a thread that uses some variables alone, without a mutex: the variables are IOTCLOUD_GUARDED_BY the role,
/// and functions that run only on that thread are IOTCLOUD_REQUIRES it. Code at the thread's start calls assert_held(),
/// and so does code of another thread that runs before the thread starts or after it was joined. Does nothing and
/// checks nothing at run time.
class IOTCLOUD_CAPABILITY("thread") ThreadRole {
 public:
  /// "This code runs on that thread, or while that thread does not run."
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(this) {}
};

}  // namespace iotcloud::config
