#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/descriptor.h>
#include <iotcloud/processes/landlock.h>

namespace iotcloud::processes {

namespace {

// Debian 12's headers know the first versions only; these are from the kernel's uapi/linux/landlock.h.
constexpr long create_ruleset = 444, add_rule = 445, restrict_self = 446;
constexpr std::uint32_t ask_version = 1;
constexpr std::uint32_t rule_path_beneath = 1, rule_port = 2;

constexpr std::uint64_t may_execute = 1U << 0U, may_write_file = 1U << 1U, may_read_file = 1U << 2U,
                        may_read_dir = 1U << 3U;
constexpr std::uint64_t may_refer = 1U << 13U, may_truncate = 1U << 14U, may_ioctl_dev = 1U << 15U;
/// remove_dir, remove_file, and all make_...
constexpr std::uint64_t may_make_and_remove = 0x1ff0;
constexpr std::uint64_t of_a_file = may_execute | may_write_file | may_read_file | may_truncate | may_ioctl_dev;
constexpr std::uint64_t may_connect = 1U << 1U;
constexpr std::uint64_t scope_signal = 1U << 1U;

struct RulesetAttributes {
  std::uint64_t files = 0;
  std::uint64_t network = 0;
  std::uint64_t scoped = 0;
};
struct [[gnu::packed]] PathBeneath {
  std::uint64_t allowed = 0;
  std::int32_t parent = -1;
};

struct Port {
  std::uint64_t allowed = 0;
  std::uint64_t port = 0;
};

/// What a kernel with this version can control.
std::uint64_t controlled(int version) {
  std::uint64_t rights = may_execute | may_write_file | may_read_file | may_read_dir | may_make_and_remove;
  if (version >= 2) rights |= may_refer;
  if (version >= 3) rights |= may_truncate;
  if (version >= 5) rights |= may_ioctl_dev;
  return rights;
}

config::Error landlock_error(const std::string& what) {
  return config::Error(fmt::format("Landlock: {}: {}", what, std::strerror(errno)));
}

void allow(int ruleset, const std::string& path, std::uint64_t rights) {
  const OwnedDescriptor parent(open(path.c_str(), O_PATH | O_CLOEXEC));
  if (!parent) {
    if (errno == ENOENT || errno == EACCES || errno == ENOTDIR) return;
    throw landlock_error(path);
  }
  struct stat status {};
  if (fstat(parent.get(), &status) != 0) throw landlock_error(path);
  if (!S_ISDIR(status.st_mode)) rights &= of_a_file;
  const PathBeneath rule{rights, parent.get()};
  if (syscall(add_rule, ruleset, rule_path_beneath, &rule, 0) != 0) throw landlock_error(path);
}

}  // namespace

int landlock_version() {
  const long version = syscall(create_ruleset, nullptr, 0, ask_version);
  return version > 0 ? static_cast<int>(version) : 0;
}

bool restrict_files(const FileAccess& allowed) {
  const int version = landlock_version();
  if (version == 0) return false;
  const std::uint64_t all = controlled(version);
  RulesetAttributes attributes{all, 0, version >= 6 ? scope_signal : 0};
  // Older kernels know a shorter structure.
  const std::size_t size = version >= 6 ? sizeof attributes : version >= 4 ? 16 : 8;
  const OwnedDescriptor ruleset(static_cast<int>(syscall(create_ruleset, &attributes, size, 0)));
  if (!ruleset) throw landlock_error("no set of rules can be made");
  for (const auto& path : allowed.read) allow(ruleset.get(), path, all & (may_execute | may_read_file | may_read_dir));
  for (const auto& path : allowed.write) allow(ruleset.get(), path, all);
  if (syscall(restrict_self, ruleset.get(), 0) != 0) throw landlock_error("the rules cannot be applied");
  return true;
}

void restrict_connections(const std::vector<std::uint16_t>& ports) {
  if (landlock_version() < landlock_of_connections) {
    throw config::Error("this kernel cannot restrict connections: it takes Linux 6.7 or newer with Landlock");
  }
  const RulesetAttributes attributes{0, may_connect, 0};
  constexpr std::size_t size_before_scopes = 16;
  const OwnedDescriptor ruleset(static_cast<int>(syscall(create_ruleset, &attributes, size_before_scopes, 0)));
  if (!ruleset) throw landlock_error("no set of rules for connections can be made");
  for (const std::uint16_t port : ports) {
    const Port rule{may_connect, port};
    if (syscall(add_rule, ruleset.get(), rule_port, &rule, 0) != 0) throw landlock_error(fmt::format("port {}", port));
  }
  if (syscall(restrict_self, ruleset.get(), 0) != 0)
    throw landlock_error("the rules for connections cannot be applied");
}

}  // namespace iotcloud::processes
