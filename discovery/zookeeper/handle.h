#pragma once

#include <array>
#include <chrono>
#include <map>
#include <memory>
#include <mutex>
#include <shared_mutex>
#include <string>
#include <vector>

#include <zookeeper/zookeeper.h>

#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/zookeeper/connection.h>

namespace iotcloud::discovery::zookeeper {

/// The outcome in the words of the seam.
Status to_status(int code);

/// One handle of the C client, which is one session, and the requests that it has not answered yet. Thread safe.
///
/// Closing a handle may take seconds (it waits for the library's threads, which may be looking a name up or writing to
/// a server that hangs) and must not happen in a callback. So it happens on a thread of its own, which keeps this
/// object until the library has let go of it.
class Handle : public std::enable_shared_from_this<Handle> {
 public:
  /// Begins to connect. \return null, with `errno` set, when not even that is possible.
  static std::shared_ptr<Handle> open(const Settings& settings, const Connection::Events& events);
  Handle(const Settings& settings, Connection::Events events) : settings_(settings), events_(std::move(events)) {}
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;

  /// Answers what is under way with `away`; no event and no answer comes when it has returned. Not from a callback.
  /// \param patience how long to wait for the end of the session; it ends in the background after that.
  void shut(std::chrono::milliseconds patience);

  void create(const std::string& path, const std::string& data, int mode, const Fence& fence, Done done);
  void set(const std::string& path, const std::string& data, int expected_version, const Fence& fence, Done done);
  void remove(const std::string& path, int expected_version, const Fence& fence, Done done);
  void get(const std::string& path, bool watch, Done done);
  void children(const std::string& path, bool watch, Done done);
  void exists_watched(const std::string& path, Done done);

 private:
  struct Request {
    Handle* handle;
    Done done;                                 ///< empty: answered by shut()
    std::array<zoo_op_result_t, 2> results{};  ///< of a fenced write: its fence's, its own
  };

  template <typename Call>
  void start(Done done, const Call& call);
  void start_fenced(const Fence& fence, const zoo_op_t& write, Done done);
  Done taken(const void* key);
  static void finish(const void* key, Reply reply);
  static void on_created(int code, const char* path, const void* request);
  static void on_stat(int code, const Stat* stat, const void* request);
  static void on_removed(int code, const void* request);
  static void on_fenced(int code, const void* request);
  static void on_data(int code, const char* data, int size, const Stat* stat, const void* request);
  static void on_names(int code, const String_vector* names, const void* request);
  static void on_event(zhandle_t* handle, int type, int state, const char* path, void* context);
  void make_chroot(zhandle_t* handle) const;
  const ACL_vector* new_nodes_acl() const;
  std::string full(const std::string& path) const;
  std::string stripped(const std::string& path) const;

  const Settings settings_;
  const Connection::Events events_;

  std::shared_mutex open_mutex_;
  zhandle_t* handle_ = nullptr;  ///< guarded by open_mutex_: shared to call, exclusive to take it away

  std::shared_mutex callback_mutex_;
  bool shut_ = false;  ///< guarded by callback_mutex_: shared while a callback runs, exclusive to set

  std::mutex requests_mutex_;
  std::map<const void*, std::unique_ptr<Request>> requests_;  ///< not answered yet; guarded by requests_mutex_
};

}  // namespace iotcloud::discovery::zookeeper
