#pragma once

#include <optional>
#include <stop_token>
#include <string>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/reasoned_outcome.h>

namespace iotcloud::master {

inline constexpr const char* lost_lead_text = "this master has just lost its lead; the order was not recorded";

OrderResult refuse(OrderRefusal refusal, std::string text);

/// This master's part in the election of a leader. Only the leader takes orders, and it writes them with the fence of
/// its lead. Thread safe.
class Leadership {
 public:
  /// Stands for election at once. \param registry outlives this. \param id of this master, for logs.
  /// \param address host:port of its API, which other masters name as the leader's.
  Leadership(discovery::Registry& registry, const std::string& path, std::string id, std::string address);
  ~Leadership() { finish(); }
  Leadership(const Leadership&) = delete;
  Leadership& operator=(const Leadership&) = delete;

  /// Ends the waiting of all orders, also of later ones.
  void close() { closing_.request_stop(); }
  /// Calls close(), and waits until no order is under way any more.
  void finish();
  std::stop_token closing() const { return closing_.get_token(); }

  std::optional<discovery::Lead> lead() const { return election_.lead(); }
  /// host:port of the master that leads; empty: none, or not known. May ask the registry.
  std::string leader() const { return election_.leading() ? address_ : election_.leader_data(); }
  /// Why this master takes no order now; nullopt: it takes them.
  std::optional<OrderResult> refusal() const;
  /// The refusal of an order that could not be written because of this error of the registry.
  OrderResult refusal_for(const discovery::RegistryError& error) const;

  /// Runs an order's body with the checks and errors that all orders share.
  template <typename Body>
  OrderResult guarded(Body&& body) {
    const UnderWay under_way(*this);
    if (auto refused = refusal()) return *refused;
    try {
      return body();
    } catch (const discovery::RegistryError& e) {
      return refusal_for(e);
    } catch (const config::Error& e) {
      return refuse(OrderRefusal::bad_request, e.what());
    }
  }

  /// Calls `write` with this master's lead. \return what `write` returns, or the outcome of an order that could not be
  /// written.
  template <typename Write>
  EarlyOutcome written(Write&& write) {
    const auto own = lead();
    if (!own) return ReasonedOutcome{OrderOutcome::failed, lost_lead_text};
    try {
      return write(*own);
    } catch (const discovery::RegistryError& e) {
      return outcome_of(e);
    }
  }

 private:
  /// Counts an order as under way while it lives.
  class UnderWay {
   public:
    explicit UnderWay(Leadership& of) : of_(of) {
      const config::MutexLock lock(of_.mutex_);
      ++of_.under_way_;
    }
    ~UnderWay() {
      const config::MutexLock lock(of_.mutex_);
      if (--of_.under_way_ == 0) of_.idle_.notify_all();
    }
    UnderWay(const UnderWay&) = delete;
    UnderWay& operator=(const UnderWay&) = delete;

   private:
    Leadership& of_;
  };
  static ReasonedOutcome outcome_of(const discovery::RegistryError& error);

  discovery::Registry& registry_;
  const std::string id_;
  const std::string address_;
  std::stop_source closing_;
  config::Mutex mutex_;
  config::ConditionVariable idle_;
  int under_way_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  discovery::Election election_;  ///< the last member, because its callbacks use the other members
};

}  // namespace iotcloud::master
