#pragma once

#include <array>
#include <cstddef>
#include <mutex>
#include <vector>

namespace iotcloud::topology::internal {

/// Recycles objects of one type without the heap: each thread keeps a few, and whole handfuls move through a shared
/// store, because what one thread makes another one gives back. Objects stay constructed while they wait.
/// Under the address sanitizer it is the heap itself, so that a use after recycling is seen.
template <typename T>
class Pool {
 public:
  static T* take() {
#if defined(__SANITIZE_ADDRESS__)
    return new T;
#else
    Cache& cache = local();
    if (cache.count == 0) store().refill(cache);
    if (cache.count == 0) return new T;
    // What was given back on another thread is still in that one's cache.
    if (cache.count > ahead) __builtin_prefetch(cache.items[cache.count - 1 - ahead], 1);
    return cache.items[--cache.count];
#endif
  }

  static void give(T* object) noexcept {
#if defined(__SANITIZE_ADDRESS__)
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
      const std::lock_guard lock(mutex_);
      while (!items_.empty() && cache.count < handful) {
        cache.items[cache.count++] = items_.back();
        items_.pop_back();
      }
    }
    void take_half(Cache& cache) {
      const std::lock_guard lock(mutex_);
      for (std::size_t i = 0; i < handful; ++i) items_.push_back(cache.items[--cache.count]);
    }
    void take_all(Cache& cache) {
      const std::lock_guard lock(mutex_);
      while (cache.count > 0) items_.push_back(cache.items[--cache.count]);
    }

   private:
    std::mutex mutex_;
    std::vector<T*> items_;  ///< guarded by mutex_
  };

  static Cache& local() {
    if (Cache* cache = cache_of_this_thread) [[likely]]
      return *cache;
    thread_local Cache cache;
    return *(cache_of_this_thread = &cache);
  }
  /// A direct access, where one to an object with a destructor is a call.
  static inline thread_local constinit Cache* cache_of_this_thread __attribute__((tls_model("initial-exec"))) = nullptr;

  /// Never destroyed: threads may end after main() has returned.
  static Store& store() {
    static Store& shared = *new Store;
    return shared;
  }
};

}  // namespace iotcloud::topology::internal
