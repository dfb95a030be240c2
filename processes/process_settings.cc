#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>
#include <iotcloud/processes/landlock.h>
#include <iotcloud/processes/process_settings.h>

namespace iotcloud::processes {

namespace {

/// Whether this daemon can have processes of that account. \throws config::Error if not.
void check_account(const std::string& user, const ConfinementWords& words, const std::string& starter) {
  const Account account = find_account(user);
  if (account.user == 0)
    throw config::Error(fmt::format("{} would run as root: name a user with no rights", words.processes));
  if (!starter.empty() || geteuid() == 0 || geteuid() == account.user) return;
  throw config::Error(fmt::format(
      "only {} that runs as root can run its {} as {} itself; let systemd start them ({}starter: /run/{}), or leave "
      "this out",
      words.daemon, words.processes, user, words.prefix, words.unit));
}

/// What is allowed for all code and for this one; nullopt: everything.
template <typename Allowed>
std::optional<std::vector<Allowed>> of_code(const std::map<std::string, std::vector<Allowed>>& all,
                                            const std::string& code) {
  if (all.empty()) return std::nullopt;
  std::vector<Allowed> allowed;
  for (const std::string& of : {std::string(every_code), code}) {
    const auto found = all.find(of);
    if (found != all.end()) allowed.insert(allowed.end(), found->second.begin(), found->second.end());
  }
  return allowed;
}

}  // namespace

std::string read_starter(config::YamlSection& file, const ConfinementWords& words) {
  return file.string_or(words.prefix + "starter", "");
}

Confinement read_confinement(config::YamlSection& file, const ConfinementWords& words, const std::string& starter) {
  Confinement confinement;
  const auto key = [&](const char* name) { return words.prefix + name; };
  confinement.no_new_privileges = true;
  confinement.filter_calls = file.bool_or(key("call_filter"), true);
  confinement.debuggable = file.bool_or(key("debugging"), false);
  confinement.user = file.string_or(key("user"), "");
  constexpr std::int64_t fewest_files = 64, most_files = 1 << 20;
  confinement.open_files = static_cast<std::uint64_t>(file.int_or(key("open_files"), 0, 0, most_files));
  if (confinement.open_files > 0 && confinement.open_files < fewest_files) {
    file.refuse(key("open_files"), fmt::format("{} alone needs some", words.one),
                fmt::format("at least {}", fewest_files));
  }
  constexpr std::int64_t most_processes = 1 << 22;
  confinement.processes = static_cast<std::uint64_t>(file.int_or(key("processes"), 0, 0, most_processes));
  if (auto files = file.optional_section(key("files"))) {
    confinement.files.emplace();
    confinement.files->read = files->strings_or("read", {});
    confinement.files->write = files->strings_or("write", {});
    files->finish();
  }
  rlimit now{};
  getrlimit(RLIMIT_NOFILE, &now);
  if (geteuid() != 0 && confinement.open_files > now.rlim_max) {
    file.refuse(key("open_files"), fmt::format("only root may give more than the {} that this user has", now.rlim_max));
  }
  if (confinement.user.empty()) {
    if (!starter.empty()) {
      file.refuse(key("starter"),
                  fmt::format("it starts {} as a user of their own, which is not named", words.processes),
                  fmt::format("{}: {}", key("user"), words.unit));
    }
    return confinement;
  }
  try {
    check_account(confinement.user, words, starter);
  } catch (const config::Error& e) {
    file.refuse(key("user"), e.what());
  }
  return confinement;
}

PortsByCode read_ports(config::YamlSection& file, const ConfinementWords& words, const Confinement& confinement) {
  PortsByCode ports;
  const std::string key = words.prefix + "ports";
  auto section = file.optional_section(key);
  if (!section) return ports;
  constexpr int highest = 65535;
  for (const std::string& code : section->names()) {
    for (const std::string& text : section->strings_or(code, {})) {
      const auto port = config::parse_number<std::uint16_t>(text);
      if (!port || *port == 0) {
        section->refuse(code, fmt::format("\"{}\" is no port", text), fmt::format("1 to {}", highest));
        continue;
      }
      ports[code].push_back(*port);
    }
  }
  section->finish();
  if (ports[every_code].empty()) {
    file.refuse(key, fmt::format("it names no ports for all, and {} would not reach the brokers", words.processes),
                fmt::format("{}: [5672]", every_code));
  }
  if (!confinement.filter_calls) {
    file.refuse(key, fmt::format("{} would get around it with the system calls that they then have", words.processes),
                words.prefix + "call_filter: true");
  }
  if (landlock_version() < landlock_of_connections) {
    file.refuse(key, "this kernel cannot restrict what its processes connect to: it takes Linux 6.7 with Landlock",
                "leave it out, and use a firewall or systemd's IPAddressAllow (deploy/README.md)");
  }
  return ports;
}

std::optional<std::vector<std::uint16_t>> ports_of(const PortsByCode& ports, const std::string& code) {
  return of_code(ports, code);
}

PlacesByCode read_network(config::YamlSection& file, const ConfinementWords& words, const Confinement& confinement) {
  PlacesByCode places;
  const std::string key = words.prefix + "network";
  auto section = file.optional_section(key);
  if (!section) return places;
  places[every_code];
  for (const std::string& code : section->names()) {
    for (const std::string& text : section->strings_or(code, {}))
      section->check(code, [&] { places[code].push_back(parse_place(text)); });
  }
  section->finish();
  file.check(key, [&] {
    const std::string lacks = lacks_for_network(confinement, words.prefix);
    if (!lacks.empty()) file.refuse(key, fmt::format("{} would get around it", words.processes), lacks);
  });
  return places;
}

std::optional<std::vector<Place>> places_of(const PlacesByCode& places, const std::string& code) {
  return of_code(places, code);
}

const std::vector<std::string>& readable_by_all() {
  static const std::vector<std::string> paths{"/usr",
                                              "/bin",
                                              "/sbin",
                                              "/lib",
                                              "/lib32",
                                              "/lib64",
                                              "/opt",
                                              "/sys",
                                              "/proc/self",
                                              "/proc/cpuinfo",
                                              "/proc/meminfo",
                                              "/proc/stat",
                                              "/proc/sys",
                                              "/proc/uptime",
                                              "/etc/ssl",
                                              "/etc/ld.so.cache",
                                              "/etc/ld.so.conf",
                                              "/etc/ld.so.conf.d",
                                              "/etc/hosts",
                                              "/etc/host.conf",
                                              "/etc/resolv.conf",
                                              "/etc/gai.conf",
                                              "/etc/nsswitch.conf",
                                              "/etc/passwd",
                                              "/etc/group",
                                              "/etc/services",
                                              "/etc/protocols",
                                              "/etc/localtime",
                                              "/etc/timezone",
                                              "/run/systemd/resolve",
                                              "/etc/ca-certificates"};
  return paths;
}

void read_time(config::YamlSection& section, const std::string& key, std::chrono::milliseconds& value) {
  value = std::chrono::duration_cast<std::chrono::milliseconds>(section.duration_or(key, value));
}

void read_log_limits(config::YamlSection& file, const std::string& prefix, int& limit_mb, int& kept) {
  auto log = file.optional_section(prefix + "log");
  if (!log) return;
  constexpr int most_mb = 1 << 20, most_kept = 1000;
  limit_mb = static_cast<int>(log->int_or("limit_mb", limit_mb, 1, most_mb));
  kept = static_cast<int>(log->int_or("kept", kept, 0, most_kept));
  log->finish();
}

void read_restarts(config::YamlSection& file, const std::string& prefix, RestartPolicy& policy) {
  auto restart = file.optional_section(prefix + "restart");
  if (!restart) return;
  read_time(*restart, "first", policy.first);
  read_time(*restart, "longest", policy.longest);
  read_time(*restart, "healthy_after", policy.healthy_after);
  constexpr int most_failures = 1'000'000;
  policy.give_up_after = static_cast<int>(restart->int_or("give_up_after", policy.give_up_after, 0, most_failures));
  restart->finish();
}

}  // namespace iotcloud::processes
