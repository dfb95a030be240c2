// iotcloud-driver-host: a process that runs all instances of one driver plugin. Started by a gateway.
#include <cstdio>
#include <cstdlib>
#include <string_view>

#include <CLI/CLI.hpp>
#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <signal.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/memory.h>
#include <iotcloud/gateway/host/control_server.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/process_starter.h>

namespace {

/// Blocks the signals that end the process before any thread exists, so that signals reach only the descriptor.
int signal_descriptor() {
  signal(SIGPIPE, SIG_IGN);
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGTERM);
  sigaddset(&ending, SIGINT);
  pthread_sigmask(SIG_BLOCK, &ending, nullptr);
  return signalfd(-1, &ending, SFD_CLOEXEC);
}

/// Loads a plugin as a host does, and prints what it is, or why it cannot be loaded, as the last line: a JSON object.
/// \return the exit status.
int check_plugin(const char* file) {
  nlohmann::ordered_json answer;
  int status = 0;
  try {
    const auto plugin = iotcloud::gateway::Plugin::load(file);
    const auto& descriptor = plugin->descriptor();
    answer = {{"driver", descriptor.name},
              {"version", descriptor.version == nullptr ? "" : descriptor.version},
              {"sdk_version", descriptor.sdk_version},
              {"cxx_abi", descriptor.cxx_abi},
              {"own_thread", descriptor.own_thread}};
    const auto declared = nlohmann::ordered_json::parse(iotcloud::config::to_json(plugin->declaration()));
    for (const char* key : {"description", "properties"}) {
      if (declared.contains(key)) answer[key] = declared[key];
    }
  } catch (const std::exception& e) {
    answer = {{"error", e.what()}};
    status = 1;
  }
  std::printf("\n%s\n", answer.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
  return status;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 3 && std::string_view(argv[1]) == "--check") return check_plugin(argv[2]);
  if (argc == 2 && std::string_view(argv[1]) == "--for-gateway") {
    return iotcloud::processes::serve_starter(iotcloud::processes::OwnedDescriptor(STDIN_FILENO),
                                              iotcloud::processes::own_program());
  }
  iotcloud::config::keep_freed_memory();
  iotcloud::gateway::ControlServer::Options options;
  CLI::App app{
      "Runs the instances of one driver plugin for an IoTCloud gateway, which starts it. `iotcloud-driver-host "
      "--check FILE` only loads a plugin and says what it is; systemd starts `iotcloud-driver-host --for-gateway` if a "
      "gateway asks for a host of another user (iotcloud-host.socket).",
      "iotcloud-driver-host"};
  app.add_option("--plugin", options.plugin_path, "the driver's shared library")->required();
  app.add_option("--name", options.order.plugin, "how orders name the plugin; its file's name when it is not given");
  app.add_option("--ordered", options.order.sha256, "the SHA-256 by which orders name it");
  app.add_option("--sha256", options.order.identity.sha256, "of its bytes, as the gateway has found them");
  app.add_option("--signed-by", options.order.identity.signed_by, "the trusted key that signed these bytes");
  app.add_flag("--exactly", options.exactly, "refuse other bytes than those");
  app.add_option("--gateway", options.order.gateway, "id of the gateway")->required();
  app.add_option("--state", options.folder, "the gateway's state folder")->required();
  app.add_option("--socket", options.socket_name, "name of the socket to listen on in the state folder")->required();
  app.add_option("--proof-check", options.proof_check, "the SHA-256 of what the gateway shows to prove that it is it")
      ->required();
  app.add_flag("--isolated", options.order.isolated, "this host is for one instance only");
  app.add_option("--listen-on", options.socket, "a descriptor that is this socket already");
  int log_limit_mb = 0;
  app.add_option("--log", options.log.path, "the file that stdout and stderr go to, which is kept within bounds");
  app.add_option("--log-limit-mb", log_limit_mb, "how large it grows before a new one is begun");
  app.add_option("--logs-kept", options.log.kept, "how many older ones are kept");
  std::string log_level = "info";
  std::string log_format = "text";
  app.add_option("--log-level", log_level, "debug, info, warn, error or off");
  app.add_option("--log-format", log_format, "text, or json: an object on each line");
  auto& confinement = options.confinement;
  app.add_option("--user", confinement.user, "the account to become before the plugin is loaded");
  app.add_option("--open-files", confinement.open_files, "how many files and sockets it may have open");
  app.add_option("--processes", confinement.processes, "how many processes and threads its user may have");
  iotcloud::processes::FileAccess files;
  app.add_option("--readable", files.read, "a file or folder that it may read, if any is named");
  app.add_option("--writable", files.write, "a file or folder that it may change, if any is named");
  std::vector<std::uint16_t> ports;
  app.add_option("--connect-to", ports,
                 "a TCP port that it may connect to, and then no other that is not named, nor UDP");
  bool only_places = false;
  iotcloud::processes::Network network{
      {}, "name it in the property `network` of the deployment, or in `host_network` of the gateway's configuration"};
  std::vector<std::string> places;
  app.add_flag("--only-places", only_places, "it connects to no other places than those that are named, if any");
  app.add_option("--place", places, "HOST:PORT of TCP to which it may connect");
  app.add_flag("--no-new-privileges", confinement.no_new_privileges, "set-user-id programs gain nothing");
  app.add_flag("!--no-debugging", confinement.debuggable, "no core dumps, no debuggers of the same user");
  app.add_flag("--filter-calls", confinement.filter_calls, "refuse system calls that no driver needs");
  CLI11_PARSE(app, argc, argv);
  if (!files.read.empty() || !files.write.empty()) confinement.files = std::move(files);
  if (!ports.empty()) confinement.ports = std::move(ports);
  if (log_limit_mb > 0) options.log.most_bytes = static_cast<std::uint64_t>(log_limit_mb) << 20;
  if (options.order.plugin.empty())
    options.order.plugin = options.plugin_path.substr(options.plugin_path.rfind('/') + 1);

  const int signals = signal_descriptor();
  const std::string socket = options.folder + "/" + options.socket_name;
  int status = 1;
  try {
    iotcloud::config::set_log_level(iotcloud::config::parse_log_level(log_level));
    iotcloud::config::set_log_format(iotcloud::config::parse_log_format(log_format));
    for (const auto& place : places) network.places.push_back(iotcloud::processes::parse_place(place));
    if (only_places) options.confinement.network = std::move(network);
    iotcloud::gateway::ControlServer server(std::move(options));
    status = server.run(signals);
    unlink(socket.c_str());
    // End at once: a stuck driver must not keep the process alive. The kernel closes the brokers' sockets.
    if (status != 0) std::_Exit(status);
  } catch (const std::exception& e) {
    iotcloud::config::Logger{"gateway.host"}.error("{}", e.what());
  }
  return status;
}
