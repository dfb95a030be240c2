// iotcloud-check: looks at what can be wrong on this machine, and packs what somebody who helps needs. `iotcloud check`
// and `iotcloud support-bundle` start it.
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <memory>

#include <CLI/CLI.hpp>
#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/utsname.h>
#include <unistd.h>

#include <iotcloud/check/bundle.h>
#include <iotcloud/check/probes.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/output/output.h>
#include <iotcloud/config/version.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/topology/plugin.h>

namespace {

using namespace iotcloud;
namespace fs = std::filesystem;
namespace output = config::output;
using Json = nlohmann::ordered_json;

constexpr std::size_t most_of_a_log = 2 << 20;  ///< bytes, from its end

struct Words {
  std::vector<std::string> configs, logs;
  std::string folder = "/etc/iotcloud", format = "table", file;
  double limit_s = 5;
};

struct Looked {
  check::Findings findings;
  std::vector<check::Machine> machines;
};

Looked look(const Words& words) {
  Looked looked;
  auto files = words.configs;
  if (files.empty()) files = check::usual_files(words.folder);
  check::check_clock(looked.findings);
  const std::chrono::milliseconds limit(static_cast<std::int64_t>(words.limit_s * 1000));
  if (files.empty()) {
    looked.findings.push_back({"configuration", words.folder, check::State::warning, "there is no daemon's file",
                               "name the files of this machine's daemons with --config"});
  }
  for (const auto& file : files) {
    looked.machines.push_back(check::read_machine(file, looked.findings));
    if (!looked.machines.back().kind.empty()) check::check_all(looked.machines.back(), limit, looked.findings);
  }
  return looked;
}

Json json_of(const check::Findings& findings) {
  Json json = Json::array();
  for (const auto& finding : findings)
    json.push_back({{"area", finding.area},
                    {"what", finding.what},
                    {"state", check::word_of(finding.state)},
                    {"says", finding.says},
                    {"mend", finding.mend}});
  return json;
}

int run_check(const Words& words) {
  const auto looked = look(words);
  std::vector<std::vector<std::string>> rows;
  bool wrong = false;
  for (const auto& finding : looked.findings) {
    rows.push_back(
        {check::word_of(finding.state), finding.area, output::printable(finding.what),
         output::printable(finding.says) + (finding.mend.empty() ? "" : ". " + output::printable(finding.mend))});
    wrong = wrong || finding.state == check::State::wrong;
  }
  const auto format = words.format == "json"   ? output::Format::json
                      : words.format == "yaml" ? output::Format::yaml
                                               : output::Format::table;
  output::print(std::cout, format, {"STATE", "AREA", "WHAT", "SAYS"}, rows, json_of(looked.findings));
  return wrong ? 1 : 0;
}

/// What a command prints, errors too; a text that says so when it cannot be run. The words are ours: no shell sees
/// others.
std::string printed(const std::string& command) {
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(popen((command + " 2>&1").c_str(), "re"), pclose);
  if (!pipe) return command + " cannot be run: " + std::strerror(errno) + "\n";
  std::string text;
  std::array<char, 4096> buffer{};
  for (std::size_t got = 0; (got = std::fread(buffer.data(), 1, buffer.size(), pipe.get())) > 0;)
    text.append(buffer.data(), got);
  return text;
}

std::string bytes_of(const std::string& file, std::size_t most) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return file + " cannot be read: " + std::strerror(errno) + "\n";
  in.seekg(0, std::ios::end);
  const auto size = static_cast<std::size_t>(std::max<std::streamoff>(in.tellg(), 0));
  in.seekg(static_cast<std::streamoff>(size > most ? size - most : 0));
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string versions() {
  utsname machine{};
  uname(&machine);
  std::string text =
      fmt::format("iotcloud {}\ndriver SDK {}\ntopology SDK {}\n{} {} {}\n", config::version, drivers::sdk_version,
                  topology::sdk_version, machine.sysname, machine.release, machine.machine);
  text += bytes_of("/etc/os-release", most_of_a_log);
  return text + printed(
                    "dpkg-query -W -f '${Package} ${Version}\\n' 'iotcloud*' 'librabbitmq4' 'librdkafka1' "
                    "'libzookeeper-mt2' 'libssl3' "
                    "'libthrift*' 'rabbitmq-server' 'zookeeper' 'mosquitto'");
}

std::string name_in_bundle(const std::string& path) {
  constexpr std::size_t longest = 80;
  std::string name = path;
  std::replace(name.begin(), name.end(), '/', '_');
  return name.size() > longest ? name.substr(name.size() - longest) : name;
}

int run_bundle(const Words& words) {
  const auto looked = look(words);
  check::Redactor redactor;
  for (const char* variable : {"IOTCLOUD_TOKEN"}) {
    if (const char* value = std::getenv(variable)) redactor.add_secret(value);
  }
  if (const char* file = std::getenv("IOTCLOUD_TOKEN_FILE")) redactor.add_secret_file(file);
  for (const auto& machine : looked.machines) {
    for (const auto& file : machine.secret_files) redactor.add_secret_file(file);
    redactor.add_secret(machine.registry.password);
    for (const auto& [name, broker] : machine.brokers) {
      if (!broker.password_variable.empty()) {
        if (const char* value = std::getenv(broker.password_variable.c_str())) redactor.add_secret(value);
      }
    }
  }
  std::map<std::string, std::string> files;
  files["versions.txt"] = versions();
  files["check.json"] = json_of(looked.findings).dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
  for (const auto& machine : looked.machines) files["configuration/" + name_in_bundle(machine.file)] = machine.text;
  const fs::path cli = fs::read_symlink("/proc/self/exe").parent_path() / "iotcloud";
  if (fs::exists(cli)) {
    for (const char* verb : {"status", "gateways", "drivers", "topologies", "events"})
      files[fmt::format("states/{}.json", verb)] =
          printed(fmt::format("timeout 20 '{}' {} -o json", cli.string(), verb));
  }
  files["logs/journal.txt"] = printed("timeout 20 journalctl --no-pager -n 5000 -u 'iotcloud-*'");
  for (const auto& machine : looked.machines) {
    for (const auto& [key, folder] : machine.folders) {
      if (key != std::string("state")) continue;
      // Daemons that run remove folders meanwhile.
      std::error_code error;
      fs::recursive_directory_iterator at(folder, fs::directory_options::skip_permission_denied, error);
      for (; at != fs::recursive_directory_iterator(); at.increment(error)) {
        std::error_code gone;
        if (at->path().extension() == ".log" && at->is_regular_file(gone))
          files["logs/" + name_in_bundle(at->path())] = bytes_of(at->path(), most_of_a_log);
      }
    }
  }
  for (const auto& log : words.logs) files["logs/" + name_in_bundle(log)] = bytes_of(log, most_of_a_log);
  for (auto& [name, text] : files) text = redactor.redacted(std::move(text));

  const std::string bytes = check::archive_of(files, config::system_clock().wall_ms() / 1000);
  const int out = open(words.file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (out < 0)
    throw config::Error(fmt::format("{} cannot be made: {}{}", words.file, std::strerror(errno),
                                    errno == EEXIST ? "; name another file" : ""));
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t wrote = write(out, bytes.data() + done, bytes.size() - done);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote < 0) {
      const int why = errno;
      close(out);
      unlink(words.file.c_str());
      throw config::Error(fmt::format("{} cannot be written: {}", words.file, std::strerror(why)));
    }
    done += static_cast<std::size_t>(wrote);
  }
  close(out);
  std::cout << fmt::format(
      "{}: {} files, {} kB. Secrets are replaced by ***; look through it before you send it: tar tzf {}\n", words.file,
      files.size(), bytes.size() / 1000, words.file);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  signal(SIGPIPE, SIG_IGN);
  Words words;
  CLI::App app{"Looks at what can be wrong on this machine.", "iotcloud-check"};
  app.require_subcommand(1);
  const auto add_common = [&](CLI::App& verb) {
    verb.add_option("--config", words.configs, "a daemon's file; again for each further one; those in /etc/iotcloud")
        ->check(CLI::ExistingFile)
        ->allow_extra_args(false);
    verb.add_option("--limit", words.limit_s, "how long registry and brokers may take to answer, in seconds")
        ->check(CLI::Range(0.1, 300.0))
        ->capture_default_str();
  };
  auto* to_check =
      app.add_subcommand("check", "Look at ports, certificates, clock, brokers, registry, plugins and disk");
  add_common(*to_check);
  to_check->add_option("-o,--output", words.format, "table, json or yaml")
      ->check(CLI::IsMember({"table", "json", "yaml"}));
  auto* to_pack =
      app.add_subcommand("support-bundle", "Pack versions, configuration, states and logs, without secrets");
  to_pack->add_option("FILE", words.file, "the new file (.tar.gz)")->required();
  add_common(*to_pack);
  to_pack->add_option("--log", words.logs, "a log to pack, too; again for each further one")
      ->check(CLI::ExistingFile)
      ->allow_extra_args(false);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  try {
    config::set_log_level(config::parse_log_level("off"));  // what clients log is in what is found
    return to_check->parsed() ? run_check(words) : run_bundle(words);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-check: %s\n", error.what());
    return 1;
  }
}
