#pragma once

#include <functional>
#include <string>
#include <utility>

#include <iotcloud/tests/discovery/passing_registry.h>

namespace iotcloud::master::test {

/// A registry that delays a write, as if its process stood still between the decision to write and the write.
class HeldUpRegistry final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;

  /// Runs before the next write. Set and called by the one thread that writes.
  void before_next_write(std::function<void()> happens) { happens_ = std::move(happens); }

  void create(const std::string& path, const std::string& data, bool parents, const Fence& fence) override {
    hold_up();
    PassingRegistry::create(path, data, parents, fence);
  }
  void set(const std::string& path, const std::string& data, std::int64_t version, const Fence& fence) override {
    hold_up();
    PassingRegistry::set(path, data, version, fence);
  }
  bool remove(const std::string& path, std::int64_t version, const Fence& fence) override {
    hold_up();
    return PassingRegistry::remove(path, version, fence);
  }

 private:
  void hold_up() {
    if (const auto happens = std::exchange(happens_, nullptr)) happens();
  }

  std::function<void()> happens_;
};

}  // namespace iotcloud::master::test
