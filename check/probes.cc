#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>
#include <thread>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/timex.h>
#include <unistd.h>

#include <iotcloud/check/probes.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/shared_library.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/topology/plugin.h>

namespace iotcloud::check {

namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;

constexpr double warn_days = 14;  ///< as the daemons' log warns
constexpr double least_free = 0.05, low_free = 0.15;
constexpr std::uint64_t least_bytes = std::uint64_t{100} << 20;
constexpr milliseconds look_pause{20};

/// Asks until it is true or the limit is over.
template <typename Condition>
bool within(milliseconds limit, const Condition& condition) {
  const auto end = Clock::now() + limit;
  while (!condition()) {
    if (Clock::now() >= end) return false;
    std::this_thread::sleep_for(look_pause);
  }
  return true;
}

std::string elapsed(Clock::time_point since) {
  return fmt::format("{} ms", std::chrono::duration_cast<milliseconds>(Clock::now() - since).count());
}

/// A socket that could be opened at the address: 0, or errno.
int open_port(const std::string& host, int port) {
  addrinfo hints{};
  hints.ai_flags = AI_PASSIVE;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(host.empty() ? nullptr : host.c_str(), std::to_string(port).c_str(), &hints, &found) != 0)
    return EADDRNOTAVAIL;
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> addresses(found, freeaddrinfo);
  const int socket = ::socket(found->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (socket < 0) return errno;
  const int one = 1;
  setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
  int error = bind(socket, found->ai_addr, found->ai_addrlen) == 0 && listen(socket, 1) == 0 ? 0 : errno;
  close(socket);
  return error;
}

/// The inode of the socket that listens at a port; empty: not seen.
std::string listening_inode(int port) {
  for (const char* table : {"/proc/net/tcp", "/proc/net/tcp6"}) {
    std::unique_ptr<FILE, int (*)(FILE*)> file(std::fopen(table, "re"), std::fclose);
    if (!file) continue;
    char line[512];
    while (std::fgets(line, sizeof line, file.get()) != nullptr) {
      char local[128];
      unsigned state = 0;
      unsigned long inode = 0;
      if (std::sscanf(line, " %*d: %127s %*s %x %*s %*s %*s %*s %*s %lu", local, &state, &inode) != 3) continue;
      const char* colon = std::strrchr(local, ':');
      constexpr unsigned listens = 0x0A;
      if (state == listens && colon != nullptr && std::strtol(colon + 1, nullptr, 16) == port)
        return std::to_string(inode);
    }
  }
  return "";
}

/// The process that has a socket: its name and id; empty: not seen, because it is another user's.
std::string holder_of(const std::string& inode) {
  if (inode.empty()) return "";
  const std::string wanted = "socket:[" + inode + "]";
  // Processes end meanwhile: errors end a list, and throw nothing.
  std::error_code error;
  const fs::directory_iterator end;
  for (fs::directory_iterator process("/proc", error); process != end; process.increment(error)) {
    const std::string id = process->path().filename();
    if (id.find_first_not_of("0123456789") != std::string::npos) continue;
    std::error_code gone;
    for (fs::directory_iterator descriptor(process->path() / "fd", gone); descriptor != end;
         descriptor.increment(gone)) {
      std::error_code closed;
      if (fs::read_symlink(descriptor->path(), closed) != wanted) continue;
      const auto program = fs::read_symlink(process->path() / "exe", closed).filename().string();
      return fmt::format("{} (process {})", program.empty() ? "a process" : program, id);
    }
  }
  return "";
}

template <typename Type, void (*free_it)(Type*)>
using Owned = std::unique_ptr<Type, std::integral_constant<void (*)(Type*), free_it>>;
using Certificate = Owned<X509, X509_free>;

void check_key(const std::string& file, X509* certificate, Findings& findings) {
  Finding finding{"certificate", file};
  struct stat about {};
  std::unique_ptr<FILE, int (*)(FILE*)> in(std::fopen(file.c_str(), "re"), std::fclose);
  if (!in || fstat(fileno(in.get()), &about) != 0) {
    finding.state = State::wrong;
    finding.says = fmt::format("the key cannot be read: {}", std::strerror(errno));
    finding.mend = "run this as the daemon's user, or give that user the file";
    findings.push_back(std::move(finding));
    return;
  }
  const std::unique_ptr<EVP_PKEY, void (*)(EVP_PKEY*)> key(PEM_read_PrivateKey(in.get(), nullptr, nullptr, nullptr),
                                                           EVP_PKEY_free);
  if (!key) {
    finding.state = State::wrong;
    finding.says = "it is no private key in PEM form without a password";
    finding.mend = "`iotcloud certs renew` makes certificate and key anew";
  } else if (certificate != nullptr && X509_check_private_key(certificate, key.get()) != 1) {
    finding.state = State::wrong;
    finding.says = "it is not the key of the certificate beside it";
    finding.mend = "copy both from the authority's folder";
  } else if ((about.st_mode & (S_IRWXG | S_IRWXO)) != 0 && (about.st_mode & S_IRWXO) != 0) {
    finding.state = State::warning;
    finding.says = "everybody on this machine may read the key";
    finding.mend = "chmod o-rwx " + file;
  } else {
    finding.says = "is the certificate's key, and private";
  }
  findings.push_back(std::move(finding));
}

Certificate check_certificate(const std::string& file, const char* what, std::int64_t now_s, Findings& findings) {
  Finding finding{"certificate", file};
  Certificate certificate;
  std::unique_ptr<FILE, int (*)(FILE*)> in(std::fopen(file.c_str(), "re"), std::fclose);
  if (in) certificate.reset(PEM_read_X509(in.get(), nullptr, nullptr, nullptr));
  if (!certificate) {
    finding.state = State::wrong;
    finding.says = in ? "it is no certificate in PEM form" : fmt::format("it cannot be read: {}", std::strerror(errno));
    finding.mend =
        in ? "`iotcloud certs add` or `certs renew` makes one" : "correct the path, or give the daemon's user the file";
    findings.push_back(std::move(finding));
    return certificate;
  }
  const std::unique_ptr<ASN1_TIME, void (*)(ASN1_TIME*)> now(ASN1_TIME_set(nullptr, now_s), ASN1_TIME_free);
  const auto days_to = [&](const ASN1_TIME* time) {
    int days = 0, seconds = 0;
    ASN1_TIME_diff(&days, &seconds, now.get(), time);
    constexpr double day = 86'400;
    return days + seconds / day;
  };
  const double left = days_to(X509_get0_notAfter(certificate.get()));
  if (days_to(X509_get0_notBefore(certificate.get())) > 0) {
    finding.state = State::wrong;
    finding.says = fmt::format("{} is not valid yet", what);
    finding.mend = "set this machine's clock, or wait";
  } else if (left < 0) {
    finding.state = State::wrong;
    finding.says = fmt::format("{} ended {:.0f} days ago", what, -left);
    finding.mend = "`iotcloud certs renew NAME`; daemons read the new file by themselves";
  } else {
    finding.state = left < warn_days ? State::warning : State::good;
    finding.says = fmt::format("{} ends in {:.0f} days", what, left);
    if (left < warn_days) finding.mend = "`iotcloud certs renew NAME`; daemons read the new file by themselves";
  }
  findings.push_back(std::move(finding));
  return certificate;
}

}  // namespace

void check_clock(Findings& findings) {
  timex state{};
  const int answer = adjtimex(&state);
  Finding finding{"clock", "this machine's"};
  constexpr std::int64_t year_2024 = 1'704'067'200;
  if (config::system_clock().wall_ms() / 1000 < year_2024) {
    finding.state = State::wrong;
    finding.says = "it stands before 2024: certificates and tokens are refused";
    finding.mend = "set it: timedatectl set-ntp true";
  } else if (answer == TIME_ERROR) {
    finding.state = State::warning;
    finding.says = "no time server keeps it: orders, tokens and certificates of other machines go by it";
    finding.mend = "timedatectl set-ntp true, or install chrony; in a container the machine's own clock counts";
  } else if (answer < 0) {
    finding.state = State::warning;
    finding.says = fmt::format("how it is kept cannot be asked here: {}", std::strerror(errno));
  } else {
    finding.says = fmt::format("kept by a time server, within {:.1f} ms", static_cast<double>(state.maxerror) / 1e3);
  }
  findings.push_back(std::move(finding));
}

void check_ports(const Machine& machine, Findings& findings) {
  for (const auto& listener : machine.listeners) {
    Finding finding{"port", fmt::format("{}:{} ({} in {})", listener.host, listener.port, listener.key, machine.file)};
    const int error = open_port(listener.host, listener.port);
    if (error == 0) {
      finding.says = "free";
    } else if (error == EADDRINUSE) {
      const std::string holder = holder_of(listening_inode(listener.port));
      if (holder.starts_with("iotcloud-")) {
        finding.says = holder + " listens";
      } else if (holder.empty()) {
        finding.state = State::warning;
        finding.says = "somebody listens there; who cannot be seen as this user";
        finding.mend = "if the daemon does not start: ss -ltnp, as root";
      } else {
        finding.state = State::wrong;
        finding.says = holder + " listens there";
        finding.mend = fmt::format("end it, or give {} another port in {}", listener.key, machine.file);
      }
    } else {
      finding.state = State::wrong;
      finding.says = fmt::format("cannot be opened: {}", std::strerror(error));
      finding.mend = error == EACCES ? "ports below 1024 are root's: take another one"
                                     : fmt::format("correct {} in {}: it is no address of this machine", listener.key,
                                                   machine.file);
    }
    findings.push_back(std::move(finding));
  }
}

void check_disk(const Machine& machine, Findings& findings) {
  for (const auto& [key, folder] : machine.folders) {
    Finding finding{"disk", fmt::format("{} ({} in {})", folder, key, machine.file)};
    struct statvfs room {};
    const bool written = key == std::string("state");
    if (statvfs(folder.c_str(), &room) != 0) {
      const bool made_later = written && errno == ENOENT;
      finding.state = made_later ? State::warning : State::wrong;
      finding.says = std::strerror(errno);
      finding.mend = made_later ? "the daemon makes it if it may" : "make it, or name another folder";
      findings.push_back(std::move(finding));
      continue;
    }
    const std::uint64_t free = std::uint64_t{room.f_bavail} * room.f_frsize;
    const double share =
        room.f_blocks == 0 ? 1 : static_cast<double>(room.f_bavail) / static_cast<double>(room.f_blocks);
    const bool no_nodes = room.f_files > 0 && room.f_favail == 0;
    finding.says = fmt::format("{:.1f} GB free ({:.0f} %)", static_cast<double>(free) / 1e9, share * 100);
    if (written && access(folder.c_str(), W_OK) != 0) {
      finding.state = State::wrong;
      finding.says = "this user may not write it";
      finding.mend = "run this as the daemon's user; for that user: chown it";
    } else if (no_nodes || (written && (free < least_bytes || share < least_free))) {
      finding.state = State::wrong;
      if (no_nodes) finding.says = "no file can be made any more: all inodes are used";
      finding.mend = "make room: spools, logs and sent plugins are there";
    } else if (written && share < low_free) {
      finding.state = State::warning;
      finding.mend = "make room before spools need it";
    }
    findings.push_back(std::move(finding));
  }
}

void check_certificates(const Machine& machine, std::int64_t now_s, Findings& findings) {
  for (const auto& [key, files] : machine.tls) {
    if (!files.ca.empty()) check_certificate(files.ca, "the authority", now_s, findings);
    Certificate own;
    if (!files.certificate.empty()) own = check_certificate(files.certificate, "it", now_s, findings);
    if (!files.key.empty()) check_key(files.key, own.get(), findings);
  }
}

void check_plugins(const Machine& machine, Findings& findings) {
  constexpr config::SdkMark sdks[] = {{"driver SDK", IOTCLOUD_DRIVER_SDK_MARK, drivers::sdk_version},
                                      {"topology SDK", IOTCLOUD_TOPOLOGY_SDK_MARK, topology::sdk_version}};
  for (const auto& [key, folder] : machine.folders) {
    if (key != std::string("plugins")) continue;
    std::vector<fs::path> files;
    std::error_code error;
    for (const auto& file : fs::directory_iterator(folder, error)) {
      if (file.path().extension() == ".so") files.push_back(file.path());
    }
    std::sort(files.begin(), files.end());
    for (const auto& file : files) {
      Finding finding{"plugin", file};
      for (const auto& sdk : sdks) {
        const auto version = config::marked_sdk_version(file, sdk);
        if (version == 0) continue;
        finding.says += fmt::format("{}{} {}", finding.says.empty() ? "" : ", ", sdk.sdk, version);
        if (version == sdk.expected) continue;
        finding.state = State::wrong;
        finding.says += fmt::format(", and this installation has {}", sdk.expected);
        finding.mend = "build it again with the installed SDK; `iotcloud plugin check` says more";
      }
      if (finding.says.empty()) {
        finding.state = State::warning;
        finding.says = "it does not say with which SDK it was built";
        finding.mend = "`iotcloud plugin check` says whether it is a plugin at all";
      }
      findings.push_back(std::move(finding));
    }
  }
}

void check_registry(const Machine& machine, milliseconds limit, Findings& findings) {
  if (machine.registry.url.empty() || machine.registry.url.starts_with("embedded")) return;
  Finding finding{"registry", machine.registry.url};
  try {
    const auto begin = Clock::now();
    auto options = machine.registry;
    options.operation_timeout = limit;
    const auto registry = discovery::make_registry(options);
    if (!within(limit, [&] { return registry->session() == discovery::SessionState::connected; })) {
      finding.state = State::wrong;
      finding.says = fmt::format("no answer within {} ms", limit.count());
      finding.mend =
          "start ZooKeeper (./dev servers up for a try), correct the address, or the tunnel to it "
          "(discovery/README.md)";
    } else {
      static_cast<void>(registry->children(discovery::Paths(machine.zk_root).sensors));
      finding.says = "answers, after " + elapsed(begin);
    }
  } catch (const discovery::RegistryError& error) {
    finding.state = State::wrong;
    finding.says = error.what();
    finding.mend = error.code() == discovery::RegistryErrorCode::denied
                       ? "give this machine its user: registry.user, registry.password_file; `iotcloud registry "
                         "rights` on a master"
                       : "see the log of ZooKeeper";
  } catch (const config::Error& error) {
    finding.state = State::wrong;
    finding.says = error.what();
    finding.mend = "correct `registry` in " + machine.file;
  }
  findings.push_back(std::move(finding));
}

void check_brokers(const Machine& machine, milliseconds limit, Findings& findings) {
  for (const auto& [name, options] : machine.brokers) {
    if (options.urls.empty() || options.urls.front().starts_with("embedded")) continue;
    Finding finding{"broker", fmt::format("{} {}", name, brokers::printable_url(options.urls.front()))};
    try {
      const auto begin = Clock::now();
      const auto broker = brokers::make_broker(options);
      // RabbitMQ's client connects for somebody only: for a reader of a queue that is gone a minute later.
      std::unique_ptr<brokers::Subscription> reader;
      if (brokers::broker_kind(options.urls.front()) == "rabbitmq") {
        const brokers::Topic topic{"iotcloud.check", fmt::format("iotcloud.check.{}", getpid()), false};
        brokers::SubscriptionOptions how;
        how.group = "check";
        how.automatic_ack = true;
        reader = broker->subscribe(topic, how, [](brokers::Delivery) {});
      }
      const bool connected = within(limit, [&] { return broker->state() == brokers::ConnectionState::connected; });
      if (connected) {
        finding.says = "takes connections, after " + elapsed(begin);
      } else if (broker->problem().find("access to") != std::string::npos) {
        finding.says = "takes connections; a queue to try it is not among the rights of this user";
      } else {
        const bool alarmed = broker->state() == brokers::ConnectionState::blocked;
        finding.state = State::wrong;
        finding.says =
            broker->problem().empty() ? fmt::format("no answer within {} ms", limit.count()) : broker->problem();
        finding.mend = alarmed
                           ? "it has a memory or disk alarm: make room on its machine"
                           : fmt::format("start it, or correct brokers.{} in {}: address, user, password, certificates",
                                         name, machine.file);
      }
    } catch (const config::Error& error) {
      finding.state = State::wrong;
      finding.says = error.what();
      finding.mend = fmt::format("correct brokers.{} in {}", name, machine.file);
    }
    findings.push_back(std::move(finding));
  }
}

void check_all(const Machine& machine, milliseconds limit, Findings& findings) {
  check_ports(machine, findings);
  check_disk(machine, findings);
  check_certificates(machine, config::system_clock().wall_ms() / 1000, findings);
  check_plugins(machine, findings);
  check_registry(machine, limit, findings);
  check_brokers(machine, limit, findings);
}

}  // namespace iotcloud::check
