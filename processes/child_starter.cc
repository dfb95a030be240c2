#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/child_starter.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {

namespace {

std::shared_ptr<const ProcessStarter> starter_of(const ChildUser& user) {
  return user.starter.empty() ? nullptr : std::make_shared<const ProcessStarter>(user.starter, user.unit);
}

std::shared_ptr<const ChildAccount> account_of(const ChildUser& user, const std::string& state_folder) {
  const bool other = !user.starter.empty() || (!user.name.empty() && geteuid() == 0);
  return other ? std::make_shared<const ChildAccount>(user.name, state_folder) : nullptr;
}

}  // namespace

ChildStarter::ChildStarter(ChildUser user, const std::string& state_folder)
    : user_(std::move(user)), starter_(starter_of(user_)), account_(account_of(user_, state_folder)) {}

ChildProcess ChildStarter::start(std::vector<std::string> arguments, std::vector<std::string> environment,
                                 const std::string& folder, const std::string& socket,
                                 const std::string& log_file) const {
  if (!starter_) return {spawn(std::move(arguments), log_file, std::move(environment)), true};
  const OwnedDescriptor log(open(log_file.c_str(), O_WRONLY | O_APPEND | O_NOFOLLOW | O_CLOEXEC));
  if (!log) throw config::Error(fmt::format("{} cannot be opened: {}", log_file, std::strerror(errno)));
  const auto listening = bind_in(folder, socket);
  return {starter_->start(arguments, environment, log, listening), starter_};
}

void ChildStarter::check(const ChildProcess& process) const {
  if (!starter_ || account_->runs(process.id())) return;
  process.kill();
  throw config::Error(
      fmt::format("{} starts processes as another user than {} says, {}", user_.starter, user_.key, user_.name));
}

std::string ChildStarter::objection(int process) const {
  return account_ && !account_->runs(process) ? fmt::format("it runs as another user than {} says", user_.key) : "";
}

std::function<void()> ChildStarter::log_keeper(LogFile::Options log) const {
  if (!account_) return {};
  return [account = account_, log = std::move(log)] { account->keep_within_bounds(log); };
}

}  // namespace iotcloud::processes
