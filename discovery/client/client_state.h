#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include <iotcloud/discovery/client/callback.h>
#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/client/holds.h>
#include <iotcloud/discovery/client/serial_thread.h>
#include <iotcloud/discovery/client/watches.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

using SessionCallback = Callback<SessionState>;

/// Everything behind the registry's face; guards refer to it weakly, so that they may outlive it without harm.
/// Three kinds of threads meet here: the callers' (calls), the worker (session, watches, holds), the dispatcher
/// (users' callbacks). The connection's own threads only post to the worker or answer a call.
class ClientState : public std::enable_shared_from_this<ClientState> {
 public:
  ClientState(std::unique_ptr<Connection> connection, RegistryOptions options)
      : options_(std::move(options)),
        connection_(std::move(connection)),
        dispatcher_("registry-calls"),
        worker_("registry"),
        watches_(*connection_, worker_, dispatcher_),
        holds_(*connection_, worker_, dispatcher_) {}
  ClientState(const ClientState&) = delete;
  ClientState& operator=(const ClientState&) = delete;

  void open();
  /// Ends calls with `closed`, threads and session. Not from a callback.
  void close();

  /// Makes one operation and waits for its answer, again when the connection was lost meanwhile.
  /// \param in_doubt set when an earlier attempt may have taken effect. \throws RegistryError away, closed.
  Reply call(const std::string& what, const std::function<void(Connection&, Done)>& operation, bool* in_doubt);

  GuardPtr add_watch(std::shared_ptr<Watch> watch);
  /// \param wait for the first creation. \return null, with the reason in `refusal`, when it is refused.
  GuardPtr add_hold(std::shared_ptr<Hold> hold, bool wait, Status& refusal);
  GuardPtr add_listener(std::function<void(SessionState)> callback);
  GuardPtr add_timer(std::chrono::milliseconds pause, std::function<void()> callback);
  SessionState session() const {
    const std::lock_guard lock(mutex_);
    return state_;
  }

 private:
  struct Pending {
    std::optional<Reply> reply;  ///< guarded by mutex_
  };
  struct WatchGuard;
  struct HoldGuard;
  struct ListenerGuard;
  struct TimerGuard;

  void on_connected(std::int64_t session, std::chrono::milliseconds timeout);
  void on_disconnected(std::chrono::steady_clock::time_point when);
  void on_expired();
  void renew_later();
  void enter(SessionState state);
  /// Waits for the worker to run `task`. Not from the worker.
  void on_worker_and_wait(std::function<void()> task);

  const RegistryOptions options_;
  std::unique_ptr<Connection> connection_;  ///< reset by close() when no thread uses it any more

  mutable std::mutex mutex_;
  std::condition_variable changed_;                ///< of all that mutex_ guards
  SessionState state_ = SessionState::connecting;  ///< guarded by mutex_; written by the worker only
  bool closed_ = false;                            ///< guarded by mutex_

  SerialThread dispatcher_;
  SerialThread worker_;
  // The worker's own:
  bool linked_ = false;
  bool renewed_in_vain_ = false;  ///< no connection since the last renewal
  std::uint64_t link_changes_ = 0;
  std::chrono::milliseconds timeout_{0};
  std::map<std::uint64_t, std::shared_ptr<SessionCallback>> listeners_;  ///< by number, in the order of their coming
  Watches watches_;
  Holds holds_;

  std::atomic<std::uint64_t> last_listener_{0};
};

}  // namespace iotcloud::discovery
