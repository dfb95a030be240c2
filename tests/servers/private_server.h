#pragma once

#include <array>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#ifndef IOTCLOUD_TEST_SERVERS
#error "iotcloud_test() defines IOTCLOUD_TEST_SERVERS, the folder of the scripts: declare this program with it"
#endif

namespace iotcloud::tests {

/// The user of a server with "--tls", which also demands a client certificate of its authority: `ca.pem`, `client.pem`
/// and `client.key` in PrivateServer::folder().
inline constexpr const char* server_user = "iotcloud";
inline constexpr const char* server_password = "secret with %: chars";

/// A real server of its own for a test process: runs a script of this folder (rabbitmq.py, kafka.py, ...), which starts
/// the server on free loopback ports and obeys one-line commands. The server ends with this object, and also when the
/// test process dies (the script sees the end of its stdin). Not thread safe.
/// Every call waits for the script's answer; after a failure it throws std::runtime_error with that answer.
/// If the server is unavailable on this machine now (its jars cannot be fetched), the test program exits with the
/// status that makes ctest report "skipped"; with CI=true the constructor throws instead.
class PrivateServer {
 public:
  /// \param script a file of this folder. \param arguments passed on. The data are in a folder of their own below the
  /// system's temporary folder and are removed at the end.
  explicit PrivateServer(const std::string& script, const std::vector<std::string>& arguments = {}) : script_(script) {
    std::string pattern = (std::filesystem::temp_directory_path() / ("iotcloud-" + script + "-XXXXXX")).string();
    if (::mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("cannot make the folder " + pattern);
    folder_ = pattern;
    launch(arguments);
    try {
      url_ = address(read_line());
    } catch (...) {
      end();
      throw;
    }
  }
  PrivateServer(const PrivateServer&) = delete;
  PrivateServer& operator=(const PrivateServer&) = delete;
  ~PrivateServer() { end(); }

  /// Where the server listens, in the form that configuration takes ("amqp://guest:guest@127.0.0.1:5672/").
  const std::string& url() const { return url_; }
  /// One URL for each node of a cluster.
  std::vector<std::string> urls() const {
    std::istringstream words(url_);
    return {std::istream_iterator<std::string>(words), {}};
  }
  /// Data and logs of the server.
  const std::filesystem::path& folder() const { return folder_; }

  void kill() { command("kill", "KILLED"); }      ///< SIGKILL: its memory is lost, its disk stays
  void start() { url_ = address(ask("start")); }  ///< after kill(): the same port, the same data
  void pause() { command("pause", "PAUSED"); }    ///< SIGSTOP: it hangs, its connections stay open
  void resume() { command("resume", "RESUMED"); }
  /// Like kill(), start(), pause() and resume(), for one node of a cluster (rabbitmq_cluster.py): 1, 2, ...
  void kill(int node) { command("kill " + std::to_string(node), "KILLED"); }
  void start(int node) { url_ = address(ask("start " + std::to_string(node))); }
  void pause(int node) { command("pause " + std::to_string(node), "PAUSED"); }
  void resume(int node) { command("resume " + std::to_string(node), "RESUMED"); }
  /// Sends a command that only this kind of server knows; throws if the answer differs from `expected`.
  void command(const std::string& text, const std::string& expected) {
    if (const std::string answer = asked(text); answer != expected) {
      throw std::runtime_error(script_ + ": " + text + ": " + answer);
    }
  }
  /// Sends such a command, and returns the answer.
  std::string asked(const std::string& text) { return ask(text); }

 private:
  void launch(const std::vector<std::string>& arguments) {
    std::array<int, 2> to_script{};
    std::array<int, 2> from_script{};
    if (::pipe2(to_script.data(), O_CLOEXEC) != 0 || ::pipe2(from_script.data(), O_CLOEXEC) != 0) {
      throw std::runtime_error("cannot make a pipe for " + script_);
    }
    const std::string path = (std::filesystem::path(IOTCLOUD_TEST_SERVERS) / script_).string();
    std::vector<std::string> words{"/usr/bin/python3", path, "--dir", folder_.string()};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    argv.reserve(words.size() + 1);
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t files;
    ::posix_spawn_file_actions_init(&files);
    ::posix_spawn_file_actions_adddup2(&files, to_script[0], STDIN_FILENO);
    ::posix_spawn_file_actions_adddup2(&files, from_script[1], STDOUT_FILENO);
    const int failure = ::posix_spawn(&process_, argv[0], &files, nullptr, argv.data(), environ);
    ::posix_spawn_file_actions_destroy(&files);
    ::close(to_script[0]);
    ::close(from_script[1]);
    commands_ = to_script[1];
    answers_ = from_script[0];
    if (failure != 0) {
      process_ = -1;
      throw std::runtime_error("cannot run " + path);
    }
    ::signal(SIGPIPE, SIG_IGN);  // a script that died is reported by the next answer
  }

  std::string ask(const std::string& command) {
    const std::string line = command + "\n";
    if (::write(commands_, line.data(), line.size()) != static_cast<ssize_t>(line.size())) {
      throw std::runtime_error(script_ + " is gone; could not send: " + command);
    }
    return read_line();
  }

  std::string address(const std::string& answer) const {
    const std::string ready = "READY ";
    if (answer.starts_with("SKIP ")) skip(answer);
    if (!answer.starts_with(ready)) throw std::runtime_error(script_ + ": " + answer);
    return answer.substr(ready.size());
  }

  /// If a test has failed before, the program still fails.
  [[noreturn]] void skip(const std::string& reason) const {
    std::cout << script_ << ": " << reason << std::endl;
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
    std::_Exit(testing::UnitTest::GetInstance()->Failed() ? EXIT_FAILURE : IOTCLOUD_TEST_SKIPPED);
  }

  std::string read_line() {
    const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(300);
    for (;;) {
      if (const auto end = received_.find('\n'); end != std::string::npos) {
        std::string line = received_.substr(0, end);
        received_.erase(0, end + 1);
        return line;
      }
      const auto left = std::chrono::ceil<std::chrono::milliseconds>(limit - std::chrono::steady_clock::now());
      pollfd waiting{answers_, POLLIN, 0};
      if (left.count() <= 0 || ::poll(&waiting, 1, static_cast<int>(left.count())) == 0) {
        throw std::runtime_error(script_ + " did not answer within 300 s");
      }
      std::array<char, 512> chunk{};
      const ssize_t size = ::read(answers_, chunk.data(), chunk.size());
      if (size == 0 || (size < 0 && errno != EINTR)) throw std::runtime_error(script_ + " ended");
      if (size > 0) received_.append(chunk.data(), static_cast<std::size_t>(size));
    }
  }

  void end() noexcept {
    ::close(commands_);  // the end of the script's stdin makes it stop the server and end
    if (process_ > 0) ::waitpid(process_, nullptr, 0);
    ::close(answers_);
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }

  std::string script_;
  std::filesystem::path folder_;
  std::string url_;
  std::string received_;
  pid_t process_ = -1;
  int commands_ = -1;  ///< the script's stdin
  int answers_ = -1;   ///< the script's stdout
};

}  // namespace iotcloud::tests
