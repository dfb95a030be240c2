#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/gateway/host/found_things.h>
#include <iotcloud/gateway/provisioning/rules.h>
#include <iotcloud/gateway/provisioning/token_bucket.h>

namespace iotcloud::gateway {

/// Makes instances of what finders find, by a gateway's rules (README.md), and ends them when it is gone. It decides
/// only: the gateway runs the instances, finders among them, as if a master had ordered them. All that finders report
/// is input of strangers. Used on one thread, the gateway's loop.
class Provisioner {
 public:
  struct Options {
    discovery::GatewayId gateway;
    ProvisioningRules rules;
    std::string file;                      ///< keeps what was found across restarts of the gateway; empty: nothing does
    const config::Clock* clock = nullptr;  ///< not null
    config::Metrics* metrics = nullptr;    ///< not null
    /// Runs an instance, or changes how it runs. \param again a person has ordered it to start: if it failed, it is
    /// started again
    std::function<void(const discovery::OrderRecord& order, bool again)> run;
    std::function<void(const discovery::InstanceId& instance)> end;
  };
  explicit Provisioner(Options options);
  /// Writes the file if that is due.
  ~Provisioner();
  Provisioner(const Provisioner&) = delete;
  Provisioner& operator=(const Provisioner&) = delete;

  /// The registry's orders are known: begins. Until then it makes nothing. A second call does nothing.
  /// \param adopted instances that an earlier run of the gateway made by rules, and that run on
  void begin(const std::set<discovery::InstanceId>& adopted);
  /// Other rules count from now on.
  void set_rules(ProvisioningRules rules);
  void heard(const FoundReport& report);

  /// A master ordered this instance: that counts, and not a rule.
  void ordered(const discovery::InstanceId& instance);
  /// A person's word about an instance that a rule makes (discovery::OrderRecord::made_by).
  void said(const discovery::OrderRecord& word);
  /// The order, or the word, is gone: an ordered instance ends, and a little later what a rule makes is there again.
  void unsaid(const discovery::InstanceId& instance);
  /// While the gateway drains, and before the first call, nothing new is made.
  void set_draining(bool draining);

  /// Does what is due. \return until it is to be called again; nullopt: not before something else is told
  std::optional<std::chrono::milliseconds> work();

 private:
  using Instant = config::Clock::Instant;
  using Address = std::pair<std::string, std::string>;  ///< a finder's name, and the key of what it found
  struct Word {
    bool active = true;
    bool withheld = false;
  };
  /// Something that was found, and the instance that a rule makes of it.
  struct Thing {
    std::map<std::string, std::string> attributes;
    bool present = false;            ///< its finder reported it, and sees since
    std::optional<Instant> missing;  ///< since when its finder would see it, and does not
    bool kept = false;               ///< an earlier run of the gateway had made its instance
    std::string rule;                ///< whose instance it has, or waits for; empty: no rule selects it
    discovery::OrderRecord order;    ///< the instance that it is to have, if it has a rule
    bool made = false;               ///< it has its instance, or its place if that is withheld
    std::string problem;             ///< why it gets none, for people; empty: nothing
    Instant changed{};               ///< when its instance was last made, or made anew
  };
  struct Finder {
    discovery::OrderRecord order;
    bool sees = false;
    bool refused_more = false;  ///< it reported more than it may
    std::set<std::string> keys;
  };
  struct Bucket {
    TokenBucket tokens;
    std::size_t made = 0;  ///< instances
  };

  const DeployRule* rule_named(const std::string& name) const;
  void make_finders();
  void consider(const Address& address, Thing& thing);
  std::string plan(const DeployRule& rule, Thing& thing, discovery::OrderRecord& order) const;
  std::string obstacle(const Address& address, const Thing& thing) const;
  bool take_token(const DeployRule& rule);
  void make(const Address& address, Thing& thing);
  void unmake(Thing& thing);
  void forget(const Address& address);
  void carry_out(const discovery::OrderRecord& order, bool again = false);
  void carry_out_now(const discovery::InstanceId& instance, bool again);
  bool may_log();
  void refuse(Thing& thing, const std::string& address, const std::string& rule, const char* kind,
              const std::string& problem);
  void take(const std::string& finder, const FoundThing& found);
  void miss(const Address& address);
  void bring_back(Instant now, std::optional<std::chrono::milliseconds>& next);
  void end_missing(Instant now, std::optional<std::chrono::milliseconds>& next);
  void make_waiting(std::optional<std::chrono::milliseconds>& next);
  void tell_finders(Instant now, std::optional<std::chrono::milliseconds>& next);
  void keep(Instant now, std::optional<std::chrono::milliseconds>& next);
  void load();
  void save();

  Options options_;
  bool begun_ = false;
  bool draining_ = true;  ///< until it is known
  bool unsaved_ = false;
  bool untold_ = false;  ///< the finders' metadata are out of date
  std::optional<Instant> saved_, told_;
  std::chrono::milliseconds save_pause_{1000};
  std::map<std::string, Finder> finders_;                      ///< by name
  std::map<discovery::InstanceId, std::string> finder_names_;  ///< by instance
  std::map<Address, Thing> things_;
  std::map<std::string, Bucket> buckets_;            ///< by rule
  std::map<discovery::InstanceId, Address> owners_;  ///< of the instances that are made
  std::set<Address> waiting_;                        ///< selected by a rule, without their instances
  std::set<Address> blocked_;                        ///< the same, until another instance makes room
  std::map<discovery::InstanceId, Word> words_;
  std::set<discovery::InstanceId> ordered_;
  /// Instances whose orders are gone, and when rules make them again: whoever removed the order sees the instance gone.
  std::map<discovery::InstanceId, Instant> returning_;
  TokenBucket log_tokens_;
};

}  // namespace iotcloud::gateway
