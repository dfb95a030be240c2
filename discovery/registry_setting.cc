#include <cstdlib>
#include <fstream>

#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/registry_setting.h>

namespace iotcloud::discovery {
namespace {

using std::chrono::milliseconds;

std::string read_password(config::YamlSection& top) {
  const auto file = top.optional_string("registry.password_file");
  const auto variable = top.optional_string("registry.password_variable");
  if (file && variable) {
    top.refuse("registry.password_variable", "the password is in \"registry.password_file\" already",
               "remove one of the two");
  }
  if (!top.runs_here()) return {};
  if (file) {
    std::ifstream in(*file);
    std::string password;
    std::getline(in, password);
    if (password.ends_with('\r')) password.pop_back();
    if (!password.empty()) return password;
    top.refuse("registry.password_file", "the file \"" + *file + "\" cannot be read, or its first line is empty",
               "a file that this process may read, with the registry's password as its first line");
  }
  if (variable) {
    const char* value = std::getenv(variable->c_str());
    if (value != nullptr && *value != '\0') return value;
    top.refuse("registry.password_variable", "the environment variable " + *variable + " is not set",
               "set it to the registry's password");
  }
  return {};
}

std::shared_ptr<const RegistryAccess> read_access(config::YamlSection& top, const std::string& file,
                                                  const std::string& user) {
  try {
    auto access = std::make_shared<const RegistryAccess>(read_registry_users(file),
                                                         Paths(top.string_or("zk.root", "/iot/sensors")));
    if (access->knows(user)) return access;
  } catch (const config::Error& e) {
    top.refuse("registry.users", e.what());
    return nullptr;
  }
  top.refuse("registry.users", "the file \"" + file + "\" has no user \"" + user + "\"",
             "make it with `iotcloud registry user`, and name it in \"registry.user\"");
  return nullptr;
}

}  // namespace

RegistryOptions read_registry_options(config::YamlSection& top) {
  RegistryOptions options;
  const std::string timeout_key = "registry.session_timeout";
  options.session_timeout =
      std::chrono::duration_cast<milliseconds>(top.duration_or(timeout_key, options.session_timeout));
  if (options.session_timeout < milliseconds(400) || options.session_timeout > std::chrono::minutes(10)) {
    top.refuse(timeout_key, "it must be from 400 ms to 10 min", "10s is usual");
  }
  options.user = top.string_or("registry.user", "");
  options.password = read_password(top);
  options.others_may_read = top.bool_or("registry.others_may_read", false);
  options.open = top.bool_or("registry.open", false);
  options.unencrypted = top.bool_or("registry.unencrypted", false);
  const bool password_given = top.has("registry.password_file") || top.has("registry.password_variable");
  if (options.user.empty() == password_given) {
    top.refuse(options.user.empty() ? "" : "registry.user", "a user of the registry and a password belong together",
               "give both \"registry.user\" and \"registry.password_file\", or neither");
  }
  if (options.user.find(':') != std::string::npos) {
    top.refuse("registry.user", "a user's name cannot have a colon", "choose another name");
  }
  const auto users = top.optional_string("registry.users");
  if (users && top.runs_here()) options.access = read_access(top, *users, options.user);
  if (options.others_may_read && options.user.empty()) {
    top.refuse("registry.others_may_read", "without a user everybody may read and write anyway",
               "add \"registry.user\", or remove this");
  }
  if (options.unencrypted && options.user.empty()) {
    top.refuse("registry.unencrypted", "without a user no registry of another machine is taken, whatever the way to it",
               "add \"registry.user\", or remove this");
  }
  if (options.open && !options.user.empty()) {
    top.refuse("registry.open", "it is for a registry without a user",
               "remove it, or \"registry.user\" and what goes with it");
  }
  return options;
}

}  // namespace iotcloud::discovery
