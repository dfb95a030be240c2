#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <fmt/format.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/check/machine.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry_setting.h>

namespace iotcloud::check {

namespace {

namespace fs = std::filesystem;
using config::YamlSection;

constexpr const char* secret_keys[] = {
    "password_file",     "reader_password_file", "key",    "signing_key",           "token_file", "gateway_token_file",
    "worker_token_file", "pool_token_file",      "tokens", "registry.password_file"};

/// The text of a key, if it is there and a text.
std::string text(YamlSection& section, const std::string& key) {
  if (!section.has(key) || section.is_mapping(key) || section.is_list(key)) return "";
  try {
    return section.string_or(key, "");
  } catch (const config::Error&) {
    return "";
  }
}

int number(YamlSection& section, const std::string& key) {
  const std::string word = text(section, key);
  const bool digits = !word.empty() && word.size() <= 5 &&
                      std::all_of(word.begin(), word.end(), [](char c) { return c >= '0' && c <= '9'; });
  return digits ? std::stoi(word) : 0;
}

std::string kind_of(YamlSection& root) {
  if (root.has("spouts") || root.has("topology.name")) return "topology";
  if (root.has("plugins")) return "gateway";
  if (root.has("api")) return "master";
  if (root.has("state") && root.has("registry")) return "pool";
  return "";
}

/// Goes through all mappings, for what may be anywhere: TLS, secrets.
void look_through(YamlSection& section, const std::string& place, Machine& machine) {
  for (const char* key : secret_keys) {
    if (const std::string file = text(section, key); !file.empty()) machine.secret_files.push_back(file);
  }
  for (const auto& name : section.names()) {
    if (!section.is_mapping(name)) continue;
    auto below = section.require_section(name);
    const std::string at = place.empty() ? name : fmt::format("{}.{}", place, name);
    if (name == "tls") {
      machine.tls.emplace_back(at, security::TlsFiles{text(below, "ca"), text(below, "certificate"), text(below, "key"),
                                                      text(below, "revoked")});
    }
    look_through(below, at, machine);
  }
}

/// The host of an address: "[::1]" is the host ::1.
std::string without_brackets(const std::string& host) {
  return host.starts_with('[') && host.ends_with(']') ? host.substr(1, host.size() - 2) : host;
}

void read_listeners(YamlSection& root, Machine& machine) {
  const std::pair<const char*, int> services[] = {
      {"thrift", machine.kind == "gateway" ? 12905 : 0}, {"api", 12904}, {"gateways", 0}};
  for (const auto& [key, usual] : services) {
    const bool there = root.has(key) && root.is_mapping(key);
    if (!there && (usual == 0 || machine.kind != (std::string(key) == "api" ? "master" : "gateway"))) continue;
    std::string host = "127.0.0.1";
    int port = usual;
    if (there) {
      auto section = root.require_section(key);
      if (const auto given = text(section, "host"); !given.empty()) host = given;
      if (const int given = number(section, "port"); given > 0) port = given;
    }
    if (port > 0) machine.listeners.push_back({key, host, port});
  }
  if (!root.has("metrics") || !root.is_mapping("metrics")) return;
  auto metrics = root.require_section("metrics");
  const std::string address = text(metrics, "address");
  const auto colon = address.rfind(':');
  if (colon == std::string::npos) return;
  const std::string port = address.substr(colon + 1);
  if (!port.empty() && port.size() <= 5 && port.find_first_not_of("0123456789") == std::string::npos &&
      std::stoi(port) > 0)
    machine.listeners.push_back({"metrics.address", without_brackets(address.substr(0, colon)), std::stoi(port)});
}

void read_parts(YamlSection& root, Machine& machine, Findings& findings) {
  const auto part = [&](const char* area, const auto& read) {
    try {
      read();
    } catch (const config::Error& error) {
      findings.push_back(
          {area, machine.file, State::wrong, error.what(), "correct it there; the daemon refuses this file, too"});
    }
  };
  part("registry", [&] {
    machine.registry = discovery::read_registry_options(root);
    machine.registry.url = text(root, "registry");
    if (machine.registry.url.empty() && root.has("zk.servers")) {
      for (const auto& server : root.strings_or("zk.servers", {}))
        machine.registry.url += (machine.registry.url.empty() ? "zookeeper://" : ",") + server;
    }
    if (const auto path = text(root, "zk.root"); !path.empty()) machine.zk_root = path;
  });
  if (root.has("brokers") && root.is_mapping("brokers")) {
    auto all = root.require_section("brokers");
    for (const auto& name : all.names()) {
      part("broker", [&] {
        auto& options = machine.brokers[name];
        if (all.is_mapping(name)) {
          auto broker = all.require_section(name);
          options = brokers::read_broker_options(broker, machine.registry.session_timeout);
        } else {
          options.urls = all.strings_or(name, {});
        }
      });
    }
  }
  for (const char* key : {"state", "plugins"}) {
    if (const auto folder = text(root, key); !folder.empty()) machine.folders.emplace_back(key, folder);
  }
  read_listeners(root, machine);
  look_through(root, "", machine);
}

}  // namespace

Machine read_machine(const std::string& file, Findings& findings) {
  Machine machine;
  machine.file = file;
  std::ifstream in(file, std::ios::binary);
  machine.text.assign(std::istreambuf_iterator<char>(in), {});
  try {
    auto root = YamlSection::load_file(file);
    machine.kind = kind_of(root);
    if (machine.kind.empty()) {
      findings.push_back({"configuration", file, State::wrong,
                          "it is the file of no daemon: it has neither plugins, api, state nor spouts",
                          "name the file of a gateway, a master, a pool or a topology with --config"});
      return machine;
    }
    findings.push_back({"configuration", file, State::good, "of a " + machine.kind});
    read_parts(root, machine, findings);
  } catch (const config::Error& error) {
    findings.push_back(
        {"configuration", file, State::wrong, error.what(), "correct it there; the daemon refuses this file, too"});
  }
  return machine;
}

std::vector<std::string> usual_files(const std::string& folder) {
  std::vector<std::string> files;
  for (const auto& place : {fs::path(folder), fs::path(folder) / "topologies"}) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(place, error)) {
      if (entry.path().extension() != ".yaml" || !entry.is_regular_file(error)) continue;
      try {
        auto root = YamlSection::load_file(entry.path());
        if (!kind_of(root).empty()) files.push_back(entry.path());
      } catch (const config::Error&) {
        files.push_back(entry.path());  // read_machine() says what is wrong with it
      }
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace iotcloud::check
