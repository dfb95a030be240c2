#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/registry.h>

namespace iotcloud::tests {

/// Forwards every call to another registry. A base class for registries that do one thing differently.
class PassingRegistry : public discovery::Registry {
 public:
  using Fence = discovery::Fence;
  using Node = discovery::Node;
  using Names = std::vector<std::string>;

  explicit PassingRegistry(std::unique_ptr<discovery::Registry> registry) : registry_(std::move(registry)) {}
  ~PassingRegistry() override = default;
  PassingRegistry(const PassingRegistry&) = delete;
  PassingRegistry& operator=(const PassingRegistry&) = delete;

  void create(const std::string& path, const std::string& data, bool parents, const Fence& fence) override {
    registry_->create(path, data, parents, fence);
  }
  void set(const std::string& path, const std::string& data, std::int64_t version, const Fence& fence) override {
    registry_->set(path, data, version, fence);
  }
  bool remove(const std::string& path, std::int64_t version, const Fence& fence) override {
    return registry_->remove(path, version, fence);
  }
  std::optional<Node> get(const std::string& path) override { return registry_->get(path); }
  std::optional<Names> children(const std::string& path) override { return registry_->children(path); }
  std::vector<std::optional<Node>> get_all(const Names& paths) override { return registry_->get_all(paths); }
  std::vector<std::optional<Names>> children_of_all(const Names& paths) override {
    return registry_->children_of_all(paths);
  }
  std::vector<std::optional<Node>> get_readable(const Names& paths) override { return registry_->get_readable(paths); }
  std::vector<std::optional<Names>> children_of_readable(const Names& paths) override {
    return registry_->children_of_readable(paths);
  }
  discovery::GuardPtr hold(const std::string& path, const std::string& data, bool sequential,
                           std::function<void(const std::string&)> on_created) override {
    return registry_->hold(path, data, sequential, std::move(on_created));
  }
  discovery::GuardPtr hold_eventually(const std::string& path, const std::string& data, bool sequential,
                                      std::function<void(const std::string&)> on_created) override {
    return registry_->hold_eventually(path, data, sequential, std::move(on_created));
  }
  discovery::GuardPtr watch_node(const std::string& path,
                                 std::function<void(const std::optional<Node>&)> callback) override {
    return registry_->watch_node(path, std::move(callback));
  }
  discovery::GuardPtr watch_children(const std::string& path,
                                     std::function<void(const std::optional<Names>&)> callback) override {
    return registry_->watch_children(path, std::move(callback));
  }
  discovery::SessionState session() const override { return registry_->session(); }
  discovery::GuardPtr on_session(std::function<void(discovery::SessionState)> callback) override {
    return registry_->on_session(std::move(callback));
  }
  discovery::GuardPtr after(std::chrono::milliseconds pause, std::function<void()> callback) override {
    return registry_->after(pause, std::move(callback));
  }

 private:
  const std::unique_ptr<discovery::Registry> registry_;
};

}  // namespace iotcloud::tests
