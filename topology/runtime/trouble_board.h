#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// The reasons, reported by the components of a topology, for which they cannot work as they should now. Thread safe.
class TroubleBoard final : public Troubles {
 public:
  /// What hinders one component.
  struct Trouble {
    std::string component;
    std::string text;
    friend bool operator==(const Trouble&, const Trouble&) = default;
  };

  void set(const std::string& component, const std::string& part, const std::string& text) override;
  /// In the order of the components' ids; a text that several parts of a component say is there once.
  std::vector<Trouble> list() const;
  /// All in one line: "count: tuples wait ...; in: channel ..."; empty: nothing hinders.
  std::string line() const;

 private:
  mutable config::Mutex mutex_;
  std::map<std::pair<std::string, std::string>, std::string> texts_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
