#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <poll.h>
#include <spawn.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {

/// Does what systemd does with the units for processes of another account: it listens as the socket's unit says, at
/// FOLDER/starter, and for each connection starts a program as the service's unit says. Takes root.
class SystemdStandIn {
 public:
  /// \param user the account. \param program and `verb` what is started, with the connection as its stdin
  SystemdStandIn(const std::filesystem::path& folder, std::string user, std::string program, std::string verb)
      : user_(std::move(user)),
        program_(std::move(program)),
        verb_(std::move(verb)),
        listener_(listen_in(folder, "starter")),
        thread_([this] { serve(); }) {}
  ~SystemdStandIn() {
    stop_.wake();
    thread_.join();
    for (const pid_t process : started_) waitpid(process, nullptr, 0);
  }
  SystemdStandIn(const SystemdStandIn&) = delete;
  SystemdStandIn& operator=(const SystemdStandIn&) = delete;

 private:
  void serve() {
    for (;;) {
      std::array<pollfd, 2> on{{{listener_.get(), POLLIN, 0}, {stop_.get(), POLLIN, 0}}};
      poll(on.data(), on.size(), -1);
      if (on[1].revents != 0) return;
      const auto connection = accept_from(listener_);
      if (connection) start(connection.get());
    }
  }
  void start(int connection) {
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, connection, STDIN_FILENO);
    std::string setpriv = "/usr/bin/setpriv", user = "--reuid=" + user_, group = "--regid=nogroup",
                none = "--clear-groups", program = program_, verb = verb_;
    std::array<char*, 7> words = {setpriv.data(), user.data(), group.data(), none.data(),
                                  program.data(), verb.data(), nullptr};
    pid_t process = 0;
    if (posix_spawn(&process, setpriv.c_str(), &actions, nullptr, words.data(), environ) == 0)
      started_.push_back(process);
    posix_spawn_file_actions_destroy(&actions);
  }

  const std::string user_, program_, verb_;
  const OwnedDescriptor listener_;
  Waker stop_;
  std::vector<pid_t> started_;
  std::thread thread_;
};

}  // namespace iotcloud::processes
