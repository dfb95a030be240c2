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
 public:
  /// \return an object as it was given back, or a new one. The caller owns it until give().
  static T* take() {
#if defined(IOTCLOUD_SANITIZED_ADDRESS)
    return new T;
#else
    Cache& cache = local();
    if (cache.count == 0) store().refill(cache);
    if (cache.count == 0) return new T;
    // An object that another thread gave back is still in that core's cache.
    if (cache.count > ahead) __builtin_prefetch(cache.items[cache.count - 1 - ahead], 1);
    return cache.items[--cache.count];
#endif
  }

  static void give(T* object) noexcept {
#if defined(IOTCLOUD_SANITIZED_ADDRESS)
    delete object;
#else
    Cache& cache = local();
    if (cache.count == cache.items.size()) store().take_half(cache);
    cache.items[cache.count++] = object;
#endif
  }

 private:
  static constexpr std::size_t handful = 64;
  static constexpr std::size_t ahead = 4;
  struct Cache {
    std::array<T*, 2 * handful> items;
    std::size_t count = 0;
    ~Cache() { store().take_all(*this); }
  };
  class Store {
   public:
    void refill(Cache& cache) {
      const config::MutexLock lock(mutex_);
      while (!items_.empty() && cache.count < handful) {
        cache.items[cache.count++] = items_.back();
        items_.pop_back();
      }
    }
    void take_half(Cache& cache) {
      const config::MutexLock lock(mutex_);
      for (std::size_t i = 0; i < handful; ++i) items_.push_back(cache.items[--cache.count]);
    }
    void take_all(Cache& cache) {
      const config::MutexLock lock(mutex_);
      while (cache.count > 0) items_.push_back(cache.items[--cache.count]);
    }

   private:
    config::Mutex mutex_;
    std::vector<T*> items_ IOTCLOUD_GUARDED_BY(mutex_);
  };

  static Cache& local() {
    if (Cache* cache = cache_of_this_thread) [[likely]]
      return *cache;
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
