// registry adopt, export, import, user, rights
#include <algorithm>
#include <filesystem>
#include <iterator>
#include <ostream>
#include <set>
#include <stdexcept>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <sys/stat.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/order_verbs.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/orders/backup_file.h>
#include <iotcloud/security/registry_password.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

class Adopt final : public Verb {
 public:
  Adopt()
      : Verb({"adopt",
              "Say that the registry's orders are meant as they stand, to gateways that are frozen because it was "
              "emptied or put back to an earlier state: they undeploy what is not ordered, and follow orders again",
              "iotcloud registry adopt lab1\n  iotcloud registry adopt --all", security::Role::admin}) {}

  void declare(CLI::App& options) override {
    auto* ids = options.add_option("GATEWAY", selection_.gateways, "ids of gateways");
    options.add_flag("--all", all_, "all gateways that are frozen")->excludes(ids);
    add_wait(options, selection_.wait);
  }
  void check() override {
    if (selection_.gateways.empty() && !all_) throw CLI::RequiredError("GATEWAY or --all");
  }
  int run(Call& call) override {
    const auto master = call.connect();
    const std::string order = discovery::to_json<nlohmann::ordered_json>(selection_).dump();
    return show_order(call, master->give("adopt", order, selection_.wait));
  }

 private:
  GatewaySelection selection_;
  bool all_ = false;
};

/// "echo.so (SHA-256 0123456789ab..., of submitted topologies)"
std::string words_of(const discovery::SentLibrary& library) {
  return fmt::format("{} (SHA-256 {}..., of submitted topologies)", library.file,
                     security::short_sha256(library.sha256));
}

class Export final : public Verb {
 public:
  Export()
      : Verb({"export",
              "Write a backup of everything that is ordered, secrets included, as JSON: the deployments of all "
              "gateways, which of them drain, the orders to topologies and the topologies that pools run. Plugins and "
              "libraries that were sent are not in it; the command names those that are needed too",
              "iotcloud registry export backup.json", security::Role::admin, false}) {}

  void declare(CLI::App& options) override {
    options
        .add_option("FILE", file_,
                    "where to; only its owner may read it, and a file that is there is replaced. Without it: to the "
                    "standard output")
        ->type_name("FILE");
  }
  int run(Call& call) override {
    const std::string text = call.connect()->backup();
    const Backup backup = decode_backup(text, file_);
    if (file_.empty()) {
      call.out << text;
    } else {
      config::replace_file(file_, text, S_IRUSR | S_IWUSR);
      call.out << fmt::format("{}: {}\n", file_, words(backup));
    }
    for (const auto& plugin : backup.missing_plugins) {
      call.err << fmt::format("not in it, keep the file: {}\n", printable(words(plugin)));
    }
    for (const auto& library : sent_libraries(backup)) {
      call.err << fmt::format("not in it, keep the file: {}\n", printable(words_of(library)));
    }
    return exit_ok;
  }

 private:
  std::string file_;
};

class Import final : public Verb {
 public:
  Import()
      : Verb({"import",
              "Write the orders of a backup into the registry; what else it has is left alone. Gateways that are "
              "frozen follow them after `iotcloud registry adopt`",
              "iotcloud registry import backup.json\n  iotcloud registry import backup.json --plugin ./turtle.so",
              security::Role::admin}) {}

  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "what `iotcloud registry export` wrote")->required()->type_name("FILE");
    options.add_flag("--replace", replace_, "orders of the backup take the place of others that stand there");
    options
        .add_option("--plugin", plugins_,
                    "a plugin that had been sent: it is sent to the gateways whose orders name it, if they do not have "
                    "it; may be given several times")
        ->type_name("FILE");
    options
        .add_option(
            "--library", libraries_,
            "a component library of a submitted topology: it is sent to all pools of workers that do not have it; "
            "may be given several times")
        ->type_name("FILE");
  }
  int run(Call& call) override {
    const Backup backup = decode_backup(bytes_of(file_), file_);
    auto missing = sent_plugins(backup.gateways);
    const auto given = plugins_among(missing);
    const auto master = call.connect();
    OrderResult all;
    for (const auto& [path, plugin] : given) send(path, plugin, *master, call, all);
    for (const auto& plugin : missing) {
      call.err << fmt::format(
          "{} was sent, and is not in the backup: on a gateway that lost it too, its instances fail until it is sent: "
          "iotcloud registry import {} --plugin FILE\n",
          printable(words(plugin)), printable(file_));
    }
    send_libraries(backup, *master, call, all);
    for (const auto& piece : pieces_of(backup, piece_bytes)) {
      const std::string order =
          discovery::to_text(discovery::to_json<nlohmann::ordered_json>(ImportRequest{piece, replace_}));
      auto result = master->give("import", order, {});
      if (result.refusal != OrderRefusal::none) {
        if (!all.outcomes.empty())
          result.text +=
              fmt::format("; {} orders before that: {}. Import it once more", all.outcomes.size(), all.summary());
        return show_order(call, result);
      }
      all.outcomes.insert(all.outcomes.end(), std::make_move_iterator(result.outcomes.begin()),
                          std::make_move_iterator(result.outcomes.end()));
    }
    return show_order(call, all);
  }

 private:
  /// A master takes orders of up to discovery::max_node_size, and one deployment may take half of that.
  static constexpr std::size_t piece_bytes = 250'000;

  /// The given files, with what the backup says of them, which it takes out of `missing`.
  /// \throws std::invalid_argument for a file that no order of the backup names.
  std::vector<std::pair<std::string, SentPluginBackup>> plugins_among(std::vector<SentPluginBackup>& missing) const {
    std::vector<std::pair<std::string, SentPluginBackup>> found;
    for (const auto& name : plugins_) {
      const std::string path = is_local_plugin(name) ? name : "./" + name;
      const auto sha256 = security::sha256_hex(plugin_bytes(path));
      const auto named =
          std::find_if(missing.begin(), missing.end(), [&](const auto& one) { return one.sha256 == sha256; });
      if (named == missing.end())
        throw std::invalid_argument(fmt::format(
            "{}: no order of {} names a plugin that was sent with these bytes (SHA-256 {})", name, file_, sha256));
      found.emplace_back(path, *named);
      missing.erase(named);
    }
    return found;
  }

  /// Sends a plugin to those of its gateways that are registered, and adds a failure for each that did not take it.
  static void send(const std::string& path, const SentPluginBackup& plugin, MasterClient& master, Call& call,
                   OrderResult& all) {
    std::set<discovery::GatewayId> known;
    for (const auto& gateway : master.gateways()) known.insert(gateway.record.id);
    std::vector<discovery::GatewayId> receivers;
    for (const auto& gateway : plugin.gateways) {
      if (known.contains(gateway)) {
        receivers.push_back(gateway);
      } else {
        all.outcomes.push_back(
            {gateway,
             {},
             OrderOutcome::failed,
             fmt::format("{} is not sent: the gateway is not registered; import it once more when it is",
                         plugin.plugin)});
      }
    }
    if (receivers.empty()) return;
    auto sent = send_plugin(path, receivers, master, call.progress ? &call.err : nullptr);
    for (auto& failure : sent.failures) failure.reason = fmt::format("{}: {}", plugin.plugin, failure.reason);
    all.outcomes.insert(all.outcomes.end(), sent.failures.begin(), sent.failures.end());
  }

  /// Sends the given libraries to the pools, and names those that are missing.
  void send_libraries(const Backup& backup, MasterClient& master, Call& call, OrderResult& all) const {
    auto missing = sent_libraries(backup);
    for (const auto& path : libraries_) {
      const auto sha256 = security::sha256_hex(plugin_bytes(path));
      if (std::erase_if(missing, [&](const auto& one) { return one.sha256 == sha256; }) == 0)
        throw std::invalid_argument(
            fmt::format("{}: no topology of {} has a library with these bytes (SHA-256 {})", path, file_, sha256));
      auto sent = send_library(path, master, call.progress ? &call.err : nullptr);
      for (auto& failure : sent.failures) failure.reason = fmt::format("{}: {}", sent.file, failure.reason);
      all.outcomes.insert(all.outcomes.end(), sent.failures.begin(), sent.failures.end());
    }
    for (const auto& library : missing) {
      call.err << fmt::format(
          "{} was sent, and is not in the backup: a pool that lost it too gets no worker of its topology until it is "
          "sent: "
          "iotcloud registry import {} --library FILE\n",
          printable(words_of(library)), printable(file_));
    }
  }

  std::string file_;
  bool replace_ = false;
  std::vector<std::string> plugins_, libraries_;
};

/// Adds an identity to the fleet's users, and prints its password.
class AddUser final : public Verb {
 public:
  AddUser()
      : Verb(
            {"user",
             "Make an identity at ZooKeeper for a process, and print its password: it is shown this once. The file has "
             "no secrets; all processes of the fleet get it (registry.users)",
             "iotcloud registry user gateway-1 --role gateway --file registry.users > gateway-1.password", std::nullopt,
             false}) {}

  void declare(CLI::App& options) override {
    options.add_option("USER", name_, "its name; for a gateway its id")->required();
    options
        .add_option("--role", role_, "master: writes orders; gateway: writes its own records; worker: of topologies")
        ->required()
        ->check(CLI::IsMember({"master", "gateway", "worker"}))
        ->type_name("ROLE");
    options.add_option("--file", file_, "the fleet's users; made if it is missing")->required()->type_name("FILE");
  }
  int run(Call& call) override {
    if (name_.find_first_of(": \t\r\n/") != std::string::npos)
      throw config::Error(fmt::format("\"{}\" cannot be a user's name: no colon, no slash, no space", name_));
    const auto there =
        std::filesystem::exists(file_) ? discovery::read_registry_users(file_) : std::vector<discovery::RegistryUser>{};
    const auto same = [&](const auto& user) { return user.name == name_; };
    if (std::any_of(there.begin(), there.end(), same))
      throw config::Error(fmt::format("{} has a user {} already; take its line out first", file_, name_));
    const auto made = security::new_registry_password(name_);
    std::string text = there.empty() ? "" : bytes_of(file_);
    if (!text.empty() && !text.ends_with('\n')) text += '\n';
    text += fmt::format("{} {}:{}\n", role_, name_, made.digest);
    config::replace_file(file_, text, S_IRUSR | S_IWUSR | S_IRGRP | S_IROTH);
    call.out << made.password << '\n';
    return exit_ok;
  }

 private:
  std::string name_, role_, file_;
};

class RenewRights final : public Verb {
 public:
  RenewRights()
      : Verb({"rights",
              "Give all nodes in ZooKeeper the rights that the fleet's users have now, after a user was added to "
              "registry.users or taken from it: nodes keep the rights with which they were made, so a gateway that was "
              "added later may not register, and a stolen password counts on. First give the new file to all processes "
              "and start them again, then run this beside a master. It counts the nodes that it looked at, those of "
              "them that had other rights, those that kept masters out (REMOVED; FOREIGN: with nodes below, so they "
              "stay), and of ZooKeeper's own nodes those that everybody may change (OPEN) and those whose rights keep "
              "this master out (SEIZED)",
              "iotcloud registry rights --registry zookeeper://127.0.0.1:2181 --user master --password-file "
              "/etc/iotcloud/registry.password --users /etc/iotcloud/registry.users",
              std::nullopt}) {}

  void declare(CLI::App& options) override {
    options.add_option("--registry", options_.url, "ZooKeeper's address, as in `registry` of master.yaml")
        ->required()
        ->type_name("URL");
    options.add_option("--user", options_.user, "a master's user")->required()->type_name("USER");
    options.add_option("--password-file", password_file_, "its password: the first line")
        ->required()
        ->type_name("FILE");
    options.add_option("--users", users_, "the fleet's users")->required()->type_name("FILE");
    options.add_option("--root", root_, "zk.root of the fleet's files")->type_name("PATH");
    options.add_flag("--unencrypted", options_.unencrypted, "as registry.unencrypted of the fleet's files");
    options.add_flag("--others-may-read", options_.others_may_read, "as registry.others_may_read of the fleet's files");
    options.add_flag(
        "--close-server", close_server_,
        "also take from everybody who reaches ZooKeeper, a driver host too, the rights on its own nodes: then only "
        "masters make and remove nodes at the top (/), and set quotas (/zookeeper). Others who use it, as Kafka or "
        "Storm, must have made a node of their own at the top by then, below which all of theirs are (a chroot); one "
        "that makes nodes at the top itself cannot go on");
  }
  int run(Call& call) override {
    const discovery::Paths paths(root_);
    const std::string text = bytes_of(password_file_);
    options_.password = text.substr(0, text.find_first_of("\r\n"));
    options_.access = std::make_shared<const discovery::RegistryAccess>(discovery::read_registry_users(users_), paths);
    if (!options_.access->is_master(options_.user)) {
      throw config::Error(
          fmt::format("{} has no master {}; only a master's user may change rights", users_, options_.user));
    }
    const auto done = discovery::renew_rights(
        options_, paths, [&](std::size_t nodes) { call.err << fmt::format("{} nodes looked at\n", nodes); },
        close_server_ ? discovery::ServersNodes::closed : discovery::ServersNodes::only_looked_at);
    const nlohmann::ordered_json answer{{"nodes", done.nodes},     {"changed", done.changed}, {"removed", done.removed},
                                        {"foreign", done.foreign}, {"open", done.open},       {"seized", done.seized}};
    print(call.out, call.format, {"NODES", "HAD OTHER RIGHTS", "REMOVED", "FOREIGN", "OPEN", "SEIZED"},
          {{std::to_string(done.nodes), std::to_string(done.changed), std::to_string(done.removed.size()),
            std::to_string(done.foreign.size()), std::to_string(done.open.size()), std::to_string(done.seized.size())}},
          answer);
    for (const auto& path : done.removed)
      call.err << fmt::format("{} kept masters out, and had nothing below: it is removed\n", path);
    for (const auto& path : done.foreign) {
      call.err << fmt::format(
          "{} keeps masters out, and has nodes below. One of the fleet's users made it with rights of its own: revoke "
          "that user, and let ZooKeeper's superuser remove the node (deleteall {}). A driver of that name runs under "
          "another one meanwhile (--driver)\n",
          path, path);
    }
    if (!done.open.empty()) {
      call.err << fmt::format(
          "everybody who reaches ZooKeeper may change {}: make and remove nodes there, or limit by quotas what masters "
          "may write. --close-server ends that; its help says what it asks of others who use this ZooKeeper\n",
          fmt::join(done.open, ", "));
    }
    for (const auto& path : done.seized) {
      call.err << fmt::format(
          "{} has rights that keep this master out. They are those of ZooKeeper's administrator, of the masters of "
          "another fleet, or of a thief, in which case its superuser gives the node back (setAcl {} "
          "world:anyone:cdrwa, then this once more)\n",
          path, path);
    }
    const bool closed = !close_server_ || done.seized.empty();
    return done.foreign.empty() && closed ? exit_ok : exit_failed;
  }

 private:
  discovery::RegistryOptions options_;
  std::string password_file_, users_, root_ = "/iot/sensors";
  bool close_server_ = false;
};

}  // namespace

void add_registry_verbs(Verbs& verbs) {
  auto& group = verbs.group("registry", "The registry: a backup, and what to do after an accident");
  group.add<Adopt>();
  group.add<Export>();
  group.add<Import>();
  group.add<AddUser>();
  group.add<RenewRights>();
}

}  // namespace iotcloud::master::cli
