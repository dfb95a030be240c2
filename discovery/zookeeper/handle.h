#pragma once

#include <array>
#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <zookeeper/zookeeper.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/zookeeper/connection.h>

namespace iotcloud::discovery::zookeeper {

/// Translates a result code of the C client.
ReplyStatus to_status(int code);

/// One handle of the C client, which is one session, and its unanswered requests. Thread safe.
///
/// Closing a handle may take seconds (it waits for the library's threads, which may be looking up a name or writing to
/// a server that hangs) and must not happen in a callback. So a thread of its own does it, and keeps this object until
/// the library no longer uses it.
class Handle : public std::enable_shared_from_this<Handle> {
 public:
  /// Begins to connect. \return null, with `errno` set, if it cannot even begin.
  static std::shared_ptr<Handle> open(const Settings& settings, const RegistryConnection::Events& events);
  Handle(const Settings& settings, RegistryConnection::Events events)
      : settings_(settings), events_(std::move(events)) {}
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;

  /// Answers pending requests with `away`; no event and no answer comes after it has returned. Do not call it from a
  /// callback.
  /// \param patience how long to wait for the end of the session, which otherwise ends in the background.
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
    Done done;                                 ///< empty: shut() has answered the request
    std::array<zoo_op_result_t, 2> results{};  ///< of a fenced write: of the check of the fence, and of the write
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
  std::string full(const std::string& path) const;
  std::string stripped(const std::string& path) const;

  const Settings settings_;
  const RegistryConnection::Events events_;

  config::SharedMutex open_mutex_;  ///< shared to call the handle, exclusive to remove it
  zhandle_t* handle_ IOTCLOUD_GUARDED_BY(open_mutex_) = nullptr;

  config::SharedMutex callback_mutex_;  ///< shared while a callback runs, exclusive to shut
  bool shut_ IOTCLOUD_GUARDED_BY(callback_mutex_) = false;
  bool identified_ = false;  ///< used on the library's callback thread only

  config::Mutex requests_mutex_;
  std::map<const void*, std::unique_ptr<Request>> requests_ IOTCLOUD_GUARDED_BY(requests_mutex_);  ///< unanswered
};

}  // namespace iotcloud::discovery::zookeeper
