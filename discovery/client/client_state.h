#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/callback.h>
#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/client/holds.h>
#include <iotcloud/discovery/client/serial_thread.h>
#include <iotcloud/discovery/client/watches.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

using SessionCallback = Callback<SessionState>;

/// The registry's implementation. Guards refer to it weakly, so they may outlive it. Three kinds of threads meet here:
/// callers (calls), the worker (session, watches, holds) and the dispatcher (users' callbacks). The connection's own
/// threads only post to the worker or answer a call.
class ClientState : public std::enable_shared_from_this<ClientState> {
 public:
  ClientState(std::unique_ptr<RegistryConnection> connection, RegistryOptions options)
      : options_(std::move(options)),
        connection_(std::move(connection)),
        dispatcher_("registry-calls"),
        worker_("registry"),
        watches_(*connection_, worker_, dispatcher_),
        holds_(*connection_, worker_, dispatcher_) {}
  ClientState(const ClientState&) = delete;
  ClientState& operator=(const ClientState&) = delete;

  void open();
  /// Makes all calls fail with `closed`, and ends the threads and the session. Do not call it from a callback.
  void close();

  /// Makes one operation and waits for its answer; repeats it if the connection was lost meanwhile.
  /// \param in_doubt set if an earlier attempt may have taken effect. \throws RegistryError away, closed.
  Reply call(const std::string& what, const std::function<void(RegistryConnection&, Done)>& operation, bool* in_doubt);

  GuardPtr add_watch(std::shared_ptr<Watch> watch);
  /// \param wait waits for the first creation. \return null, with the reason in `refusal`, if the server refuses it.
  GuardPtr add_hold(std::shared_ptr<Hold> hold, bool wait, ReplyStatus& refusal);
  GuardPtr add_listener(std::function<void(SessionState)> callback);
  GuardPtr add_timer(std::chrono::milliseconds pause, std::function<void()> callback);
  SessionState session() const {
    const config::MutexLock lock(mutex_);
    return state_;
  }

 private:
  struct Pending {
    std::optional<Reply> reply;  ///< guarded by the client's mutex_, which the analysis cannot see from here
  };
  struct WatchGuard;
  struct HoldGuard;
  struct ListenerGuard;
  struct TimerGuard;

  void on_connected(std::int64_t session, std::chrono::milliseconds timeout);
  void on_disconnected(std::chrono::steady_clock::time_point when);
  void on_expired();
  void ask_for_new(std::uint64_t change);
  std::chrono::milliseconds moment() const;
  void on_serving(std::uint64_t change);
  void renew_later();
  void enter(SessionState state);
  /// Waits until the worker has run `task`. Do not call it on the worker.
  void on_worker_and_wait(std::function<void()> task);

  const RegistryOptions options_;
  std::unique_ptr<RegistryConnection> connection_;  ///< close() resets it when no thread uses it any more

  mutable config::Mutex mutex_;
  config::ConditionVariable changed_;  ///< notified of changes to all that mutex_ guards
  SessionState state_ IOTCLOUD_GUARDED_BY(mutex_) = SessionState::connecting;  ///< written by the worker only
  std::string why_away_ IOTCLOUD_GUARDED_BY(mutex_);  ///< for those who wait for a connection; empty: not known
  bool closed_ IOTCLOUD_GUARDED_BY(mutex_) = false;

  SerialThread dispatcher_;
  SerialThread worker_;
  // Used by the worker only:
  bool linked_ = false;
  bool renewed_in_vain_ = false;  ///< on_expired() has asked for a new session, which has not been connected yet
  std::uint64_t link_changes_ = 0;
  std::chrono::milliseconds timeout_{0};
  /// by number, in the order in which they were added
  std::map<std::uint64_t, std::shared_ptr<SessionCallback>> listeners_;
  Watches watches_;
  Holds holds_;

  std::atomic<std::uint64_t> last_listener_{0};
};

}  // namespace iotcloud::discovery
