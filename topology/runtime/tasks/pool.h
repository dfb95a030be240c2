#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <vector>

#include <iotcloud/config/mutex.h>

namespace iotcloud::topology::internal {

/// Recycles objects of one type without the heap. Each thread keeps a cache; handfuls of objects move between the
/// caches through a shared store, because often one thread takes the objects and another one gives them back. Objects
/// stay constructed while they are in the pool. Under the address sanitizer every object is allocated and deleted, so
/// that the sanitizer sees a use after recycling. Thread safe.
template <typename T>
class Pool {
  static constexpr std::size_t handful = 256;

 public:
  /// The objects of one thread; only that thread uses it.
  class Cache {
   public:
    Cache() { top_ = bottom(); }
    ~Cache() { store().take(*this, static_cast<std::size_t>(top_ - bottom())); }
    Cache(const Cache&) = delete;
    Cache& operator=(const Cache&) = delete;

    /// \return an object as it was given back, or a new one. The caller owns it until give().
    [[gnu::always_inline]] T* take() {
#if defined(IOTCLOUD_SANITIZED_ADDRESS)
      return new T;
#else
      if (top_ == bottom()) [[unlikely]] {
        if (T* made = refill()) return made;
      }
      return *--top_;
#endif
    }

    [[gnu::always_inline]] void give(T* object) noexcept {
#if defined(IOTCLOUD_SANITIZED_ADDRESS)
      delete object;
#else
      if (top_ == items_.data() + items_.size()) [[unlikely]]
        drain();
      *top_++ = object;
#endif
    }

   private:
    friend class Pool;
    T** bottom() {
      return items_.data();
    }
    // Not inlined, so that the functions that take and give need few registers.
    /// \return a new object, or nullptr: there are some in the cache now.
    [[gnu::noinline]] T* refill() {
      store().give(*this);
      return top_ == bottom() ? new T : nullptr;
    }
    [[gnu::noinline]] void drain() noexcept {
      store().take(*this, handful);
    }

    T** top_;  ///< behind the object that was given back last
    std::array<T*, 2 * handful> items_;
  };

  /// The cache of the calling thread.
  [[gnu::always_inline]] static Cache& local() {
    if (Cache* cache = cache_of_this_thread) [[likely]]
      return *cache;
    return make_local();
  }
  [[gnu::always_inline]] static T* take() {
    return local().take();
  }
  [[gnu::always_inline]] static void give(T* object) noexcept {
    local().give(object);
  }

 private:
  class Store {
   public:
    void give(Cache& cache) {
      const config::MutexLock lock(mutex_);
      for (std::size_t i = 0; i < handful && !items_.empty(); ++i) {
        *cache.top_++ = items_.back();
        items_.pop_back();
      }
    }
    void take(Cache& cache, std::size_t count) {
      const config::MutexLock lock(mutex_);
      for (std::size_t i = 0; i < count; ++i) items_.push_back(*--cache.top_);
    }

   private:
    config::Mutex mutex_;
    std::vector<T*> items_ IOTCLOUD_GUARDED_BY(mutex_);
  };

  [[gnu::noinline]] static Cache& make_local() {
    // On the heap: a library that a running program loads (topology/storm) has little room for such a pointer's block.
    thread_local const std::unique_ptr<Cache> cache = std::make_unique<Cache>();
    return *(cache_of_this_thread = cache.get());
  }
  /// Points to local()'s object. Reading this pointer needs no function call; reading a thread_local object with a
  /// destructor does.
  static inline thread_local constinit Cache* cache_of_this_thread __attribute__((tls_model("initial-exec"))) = nullptr;

  /// Never destroyed: threads may end after main() has returned.
  static Store& store() {
    static Store& shared = *new Store;
    return shared;
  }
};

}  // namespace iotcloud::topology::internal
