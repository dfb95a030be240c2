// deploy, undeploy, start, stop, restart, metadata, update; drain, undrain
#include <algorithm>
#include <optional>
#include <ostream>
#include <set>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/fleet/channel_options.h>
#include <iotcloud/master/cli/fleet/plugin_declarations.h>
#include <iotcloud/master/cli/fleet/property_check.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/order_verbs.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/master/cli/waiting.h>

namespace iotcloud::master::cli {

using security::Role;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

namespace {

/// Shows an answer. Each gateway that did not take the plugin is shown as a failed outcome.
int show_order_and_failures(Call& call, OrderResult result, const SentPlugin& sent, bool given = true) {
  if (sent.failures.empty()) return show_order(call, result);
  std::string text = given ? result.summary() : "";
  text += fmt::format("{}{} gateway{} did not take the plugin", text.empty() ? "" : "; ", sent.failures.size(),
                      sent.failures.size() == 1 ? "" : "s");
  result.outcomes.insert(result.outcomes.end(), sent.failures.begin(), sent.failures.end());
  return show_order(call, result, text, false);
}

std::string joined(const std::vector<std::string>& words) {
  return fmt::format("{}", fmt::join(words, ", "));
}

WaitingReport::Concerns is_one_of(const std::vector<discovery::InstanceId>& ids) {
  return [&ids](const discovery::DriverRecord& driver) {
    return std::find(ids.begin(), ids.end(), driver.instance) != ids.end();
  };
}

/// What a plugin that is a file of this machine declares. The file is read, not loaded.
DeclaredPlugin declared_by_file(const std::string& path) {
  return {path, config::declaration_in(plugin_bytes(path))};
}

/// \throws std::invalid_argument that says all that is wrong with the properties
void refuse_wrong(const config::Properties& properties, const std::vector<DeclaredPlugin>& plugins) {
  const auto problems = property_problems(properties, plugins);
  if (!problems.empty()) throw std::invalid_argument(lines_of(problems));
}

class Deploy final : public Verb {
 public:
  Deploy()
      : Verb({"deploy", "Deploy a driver; answers when the outcome is known",
              "iotcloud deploy turtle.so --gateway lab1 --name robot --property source=simulation\n"
              "  iotcloud deploy --plugin ./turtle.so --all",
              Role::admin}) {}

  void declare(CLI::App& options) override {
    add_plugin(options, request_.plugin);
    options.add_option("PLUGIN", request_.plugin, "as --plugin")->excludes("--plugin");
    add_gateways(options, request_.gateways, "on these gateways: -g lab1 lab2").allow_extra_args();
    options.add_flag("--all", all_, "on all gateways")->excludes("--gateway");
    options
        .add_option("--name", request_.name,
                    "what these instances are called: NAME/1, NAME/2, ... on each gateway; one that is there already "
                    "is not deployed again")
        ->type_name("NAME");
    options.add_option("--driver", request_.driver, "the driver's name; the plugin's own when it is not given")
        ->type_name("DRIVER");
    add_words(options, "-p,--property", properties_,
              "a property of the driver; may be repeated. {index} in a value stands for the instance's number",
              "NAME=VALUE");
    add_words(options, "-c,--channel", channels_,
              "what a channel's messages are worth, such as data.deadline_ms=100; may be repeated. Options: " +
                  joined(channel_options()),
              "CHANNEL.OPTION=VALUE");
    add_words(options, "-m,--metadata", metadata_, "what others see in the driver's record; may be repeated",
              "NAME=VALUE");
    options
        .add_option("--on-partition", on_partition_,
                    "what the instances do when the registry has not confirmed their gateway for the time of --lease")
        ->check(CLI::IsMember({"stop", "continue"}))
        ->type_name("stop|continue");
    options.add_option("--lease", lease_, "that time, for --on-partition stop, such as 30s")->type_name("TIME");
    options.add_option("-n,--count", request_.count, "instances on each gateway")
        ->check(CLI::Range(1, DeployRequest::max_count))
        ->type_name("N");
    add_wait(options, request_.wait);
  }

  void check() override {
    take_plugin_back();
    if (request_.gateways.empty() && !all_) throw CLI::RequiredError("--gateway GATEWAY or --all");
    request_.properties = pairs(properties_, "--property");
    add_channels(pairs(channels_, "--channel"));
    add_lease();
    request_.metadata = pairs(metadata_, "--metadata");
    if (request_.plugin.empty()) throw CLI::RequiredError("--plugin");
  }

  int run(Call& call) override {
    const auto master = call.connect();
    check_properties(call, *master);
    SentPlugin sent;
    if (is_local_plugin(request_.plugin)) {
      sent = send_plugin(request_.plugin, gateways_to_send_to(*master), *master, call.progress ? &call.err : nullptr);
      if (sent.gateways.empty()) return show_order_and_failures(call, {}, sent, false);
      request_.gateways = sent.gateways;
      request_.plugin = sent.plugin;
      request_.sha256 = sent.sha256;
    }
    return show_order_and_failures(call, deploy(call, *master), sent);
  }

 private:
  /// In `deploy -g lab1 turtle.so` the option takes the plugin, too.
  void take_plugin_back() {
    if (!request_.plugin.empty() || request_.gateways.size() < 2) return;
    const std::string last = request_.gateways.back();
    if (!last.ends_with(".so") && !is_local_plugin(last)) return;
    request_.plugin = last;
    request_.gateways.pop_back();
  }
  static void add_words(CLI::App& options, const char* name, std::vector<std::string>& words, const std::string& what,
                        const char* type) {
    options.add_option(name, words, what)->allow_extra_args(false)->type_name(type);
  }

  OrderResult deploy(const Call& call, MasterClient& master) const {
    const auto& gateways = request_.gateways;
    const WaitingReport waiting(call, [&, begun = now_ms()](const discovery::DriverRecord& driver) {
      const bool here =
          gateways.empty() || std::find(gateways.begin(), gateways.end(), driver.gateway) != gateways.end();
      if (!here) return false;
      if (!request_.name.empty()) return driver.deployment == request_.name;
      return driver.since_ms >= begun && (driver.plugin.empty() || driver.plugin == request_.plugin);
    });
    return master.deploy(request_);
  }

  /// Turns the choice for partitions into properties. \throws CLI::ValidationError
  void add_lease() {
    if ((on_partition_ == "stop") == lease_.empty())
      throw CLI::ValidationError("--lease", "goes with --on-partition stop, and only with it");
    for (const auto& [property, value] : {std::pair("on_partition", on_partition_), std::pair("lease", lease_)}) {
      if (!value.empty() && !request_.properties.emplace(property, value).second)
        throw CLI::ValidationError("--property", std::string(property) + " is given by an option too");
    }
  }

  /// Turns the options of channels into properties. \throws CLI::ValidationError
  void add_channels(const std::map<std::string, std::string>& settings) {
    for (const auto& [setting, value] : settings) {
      auto problem = channel_setting_problem(setting, value);
      const auto dot = setting.rfind('.');
      const auto property =
          dot == std::string::npos ? setting : channel_property(setting.substr(0, dot), setting.substr(dot + 1));
      if (problem.empty() && !request_.properties.emplace(property, value).second)
        problem = property + " is given as a --property too";
      if (!problem.empty()) throw CLI::ValidationError("--channel", problem);
    }
    for (const auto& [setting, value] : settings) {
      const auto dot = setting.rfind('.');
      const auto when_full = request_.properties.find(channel_property(setting.substr(0, dot), "when_full"));
      const auto problem = spool_option_problem(setting.substr(dot + 1),
                                                when_full == request_.properties.end() ? "" : when_full->second);
      if (!problem.empty()) throw CLI::ValidationError("--channel", problem);
    }
  }

  /// Compares the properties with what the plugin declares. \throws std::invalid_argument that says all that is wrong
  void check_properties(Call& call, MasterClient& master) {
    for (int i = 1; i <= request_.count; ++i) {
      if (auto own = config::numbered(request_.properties, i); !own.empty())
        request_.own.push_back({i, std::move(own)});
    }
    PluginDeclarations on_gateways(master);
    const auto plugins = is_local_plugin(request_.plugin)
                             ? std::vector<DeclaredPlugin>{declared_by_file(request_.plugin)}
                             : on_gateways.of(request_.plugin, request_.gateways);
    auto properties = request_.properties;
    if (!request_.own.empty()) {
      // The numbers grow, so the last instance has the largest.
      for (const auto& [name, value] : request_.own.back().properties) properties[name] = value;
    }
    refuse_wrong(properties, plugins);
    if (!properties.empty()) tell_unchecked(on_gateways, call.err);
  }

  /// The gateways that get the plugin. A plugin for all gateways skips those that drain, as the order does.
  std::vector<discovery::GatewayId> gateways_to_send_to(MasterClient& master) const {
    if (!request_.gateways.empty()) return request_.gateways;
    std::vector<discovery::GatewayId> ids;
    bool draining = false;
    for (const auto& gateway : master.gateways()) {
      draining = draining || gateway.draining;
      if (!gateway.draining) ids.push_back(gateway.record.id);
    }
    if (ids.empty() && draining) throw RequestFailed("all gateways are draining; `iotcloud undrain GATEWAY` ends that");
    return ids;
  }

  DeployRequest request_;
  bool all_ = false;
  std::vector<std::string> properties_, channels_, metadata_;
  std::string on_partition_, lease_;
};

/// A verb that orders something of deployed instances.
class ForInstances : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override {
    choice_.add_ids(options, "ids of instances, or how they begin, or names (meter/2)");
    add_choice(options);
  }
  void check() override { choice_.check_order(); }
  int run(Call& call) override {
    const auto master = call.connect();
    const InstanceChoice choice = choice_.with_all_gateways(*master);
    return give(call, *master, {choice.ids(*master), choice.gateways, wait_});
  }

 protected:
  virtual int give(Call& call, MasterClient& master, const InstanceSelection& selection) = 0;
  void add_choice(CLI::App& options) {
    choice_.add_what_they_are(options, "the instances must be on one of these gateways");
    options.add_flag("--all", choice_.all, "all instances, or all on the gateways that are named");
    add_wait(options, wait_);
  }

  InstanceChoice choice_;
  WaitLimit wait_;
};

/// undeploy, start, stop
class ChangeInstances final : public ForInstances {
 public:
  using Order = OrderResult (MasterClient::*)(const InstanceSelection&);
  ChangeInstances(const Card& of, Order order) : ForInstances(of), order_(order) {}

 private:
  int give(Call& call, MasterClient& master, const InstanceSelection& selection) override {
    return show_order(call, ordered(call, master, selection));
  }
  OrderResult ordered(const Call& call, MasterClient& master, const InstanceSelection& selection) const {
    const WaitingReport waiting(call, is_one_of(selection.instances));
    return (master.*order_)(selection);
  }
  const Order order_;
};

class Restart final : public ForInstances {
 public:
  Restart()
      : ForInstances({"restart", "Stop driver instances, and start those that have stopped",
                      "iotcloud restart 3f2a9c\n  iotcloud restart --name meter", Role::operating}) {}

 private:
  int give(Call& call, MasterClient& master, const InstanceSelection& selection) override {
    constexpr std::size_t steps = 2;
    const std::string order = discovery::to_json<Json>(selection).dump();
    std::optional<WaitingReport> waiting(std::in_place, call, is_one_of(selection.instances));
    const auto result = master.give("restart", order, selection.wait, steps);
    waiting.reset();
    return show_order(call, result);
  }
};

class Metadata final : public ForInstances {
 public:
  Metadata()
      : ForInstances({"metadata",
                      "Change the metadata in the records of driver instances. A value that the driver itself reports "
                      "takes precedence",
                      "iotcloud metadata 3f2a9c site=lab 'location=39.17,-86.52' note=", Role::operating}) {}

  void declare(CLI::App& options) override {
    options
        .add_option("ID KEY=VALUE", words_,
                    "ids of instances, or their beginnings, and what to change; \"KEY=\" removes the key")
        ->required();
    add_choice(options);
  }

  void check() override {
    std::vector<std::string> changes;
    for (const auto& word : words_) (word.find('=') == std::string::npos ? choice_.instances : changes).push_back(word);
    if (changes.empty()) throw CLI::RequiredError("KEY=VALUE");
    changes_ = pairs(changes, "KEY=VALUE");
    ForInstances::check();
  }

 private:
  int give(Call& call, MasterClient& master, const InstanceSelection& selection) override {
    return show_order(call, master.update_metadata(selection, changes_));
  }

  std::vector<std::string> words_;
  MetadataChanges changes_;
};

class Update final : public ForInstances {
 public:
  Update()
      : ForInstances({"update",
                      "Give driver instances another version of their plugin, other properties, or both, one gateway "
                      "after the other. When one does not come up with it, all go back to what they had",
                      "iotcloud update --plugin ./turtle-2.so --driver turtle\n"
                      "  iotcloud update --property rate=5 --name meter",
                      Role::admin}) {}

  void declare(CLI::App& options) override {
    ForInstances::declare(options);
    add_plugin(options, request_.plugin);
    options
        .add_option("-p,--property", words_,
                    "a property to change; may be repeated. \"NAME=\" takes it away; the others stay")
        ->allow_extra_args(false)
        ->type_name("NAME=VALUE");
    options.add_option("--at-once", request_.at_once, "so many instances in one step, not all of one gateway")
        ->check(CLI::Range(1, UpdateRequest::max_at_once))
        ->type_name("N");
    add_settle(options, request_.settle);
  }

  void check() override {
    if (request_.plugin.empty() && words_.empty()) throw CLI::RequiredError("--plugin or --property");
    changes_ = pairs(words_, "--property");
    ForInstances::check();
  }

 private:
  /// Gives no order unless all gateways of the instances have the plugin.
  int give(Call& call, MasterClient& master, const InstanceSelection& selection) override {
    const std::set<discovery::InstanceId> chosen(selection.instances.begin(), selection.instances.end());
    std::set<discovery::GatewayId> gateways;
    for (const auto& driver : master.drivers()) {
      if (chosen.contains(driver.instance)) gateways.insert(driver.gateway);
    }
    set_properties(call, master, selection);
    if (!gateways.empty() && !request_.plugin.empty()) {
      const auto sent =
          send_plugin(request_.plugin, {gateways.begin(), gateways.end()}, master, call.progress ? &call.err : nullptr);
      if (!sent.failures.empty()) {
        call.err << "iotcloud: not all gateways took the plugin, so no instance was updated\n";
        return show_order_and_failures(call, {}, sent, false);
      }
      request_.plugin = sent.plugin;
      request_.sha256 = sent.sha256;
    }
    request_.selection = selection;
    const auto per_step = static_cast<std::size_t>(request_.at_once);
    const std::size_t steps = per_step == 0 ? gateways.size() : (chosen.size() + per_step - 1) / per_step;
    return show_order(call, update(call, master, steps));
  }

  OrderResult update(const Call& call, MasterClient& master, std::size_t steps) const {
    const WaitingReport waiting(call, is_one_of(request_.selection.instances));
    return master.update(request_, steps);
  }

  /// Works out the properties that each instance is to have, and checks them against what its plugin declares.
  void set_properties(Call& call, MasterClient& master, const InstanceSelection& selection) {
    const std::set<discovery::InstanceId> chosen(selection.instances.begin(), selection.instances.end());
    PluginDeclarations on_gateways(master);
    std::vector<DeclaredPlugin> by_file;
    if (is_local_plugin(request_.plugin)) by_file.push_back(declared_by_file(request_.plugin));
    std::vector<ListedOrder> all;
    try {
      all = master.orders();
    } catch (const RequestFailed&) {
      // Whoever may not list orders may not update either. The answer to the update says which role that takes.
      if (!changes_.empty()) throw;
    }
    for (const auto& placed : all) {
      const auto& order = placed.order;
      const bool here = selection.gateways.empty() || std::find(selection.gateways.begin(), selection.gateways.end(),
                                                                placed.gateway) != selection.gateways.end();
      if (!chosen.contains(order.instance) || !here) continue;
      auto properties = order.properties;
      for (const auto& [name, value] : changes_) {
        if (value.empty()) {
          properties.erase(name);
        } else {
          properties[name] = value;
        }
      }
      for (auto& [name, value] : config::numbered(properties, order.index)) properties[name] = value;
      const bool as_it_is = request_.plugin.empty();
      if (!by_file.empty()) {
        refuse_wrong(properties, by_file);
      } else if (as_it_is && !order.sha256.empty()) {
        refuse_wrong(properties, on_gateways.sent(order.sha256));
      } else {
        refuse_wrong(properties, on_gateways.of(as_it_is ? order.plugin : request_.plugin, {placed.gateway}));
      }
      if (!changes_.empty()) request_.properties.push_back({order.instance, std::move(properties)});
    }
    if (!changes_.empty()) tell_unchecked(on_gateways, call.err);
  }

  UpdateRequest request_;
  std::vector<std::string> words_;
  std::map<std::string, std::string> changes_;
};

class Drain final : public Verb {
 public:
  explicit Drain(bool undo)
      : Verb(undo ? Card{"undrain",
                         "Let gateways work again: what drain stopped starts, what had been stopped before "
                         "stays so",
                         "iotcloud undrain lab1", Role::operating}
                  : Card{"drain",
                         "Stop all instances of gateways, and deploy nothing on them any more, until: "
                         "iotcloud undrain",
                         "iotcloud drain lab1", Role::operating}),
        can_undo_(!undo),
        undo_(undo) {}

  void declare(CLI::App& options) override {
    options.add_option("GATEWAY", selection_.gateways, "ids of gateways")->required();
    add_wait(options, selection_.wait);
    if (can_undo_) options.add_flag("--undo", undo_, "the same as undrain");
  }
  int run(Call& call) override {
    const auto master = call.connect();
    return show_order(call, undo_ ? master->undrain(selection_) : master->drain(selection_));
  }

 private:
  const bool can_undo_;
  bool undo_;
  GatewaySelection selection_;
};

}  // namespace

int show_order(Call& call, const OrderResult& result) {
  return show_order(call, result, result.summary(), result.all_done());
}

int show_order(Call& call, const OrderResult& result, const std::string& text, bool ok) {
  if (call.format != Format::table) {
    print_data(call.out, call.format,
               {{"ok", ok}, {"text", text}, {"outcomes", discovery::json_of<Json>(result.outcomes)}});
    return ok ? exit_ok : exit_failed;
  }
  if (result.refusal != OrderRefusal::none) {
    call.err << "iotcloud: " << printable(text) << '\n';
    return exit_failed;
  }
  Rows rows;
  for (const auto& outcome : result.outcomes)
    rows.push_back(
        {outcome.instance, printable(outcome.gateway), to_string(outcome.outcome), printable(outcome.reason)});
  if (rows.empty()) {
    call.out << "done; no instance had to change\n";
  } else {
    print_table(call.out, {"INSTANCE", "GATEWAY", "OUTCOME", "REASON"}, rows);
  }
  return ok ? exit_ok : exit_failed;
}

void add_order_verbs(Verbs& verbs) {
  verbs.add<Deploy>();
  verbs.add<ChangeInstances>(Verb::Card{"undeploy", "Take driver instances away",
                                        "iotcloud undeploy --state failed --gateway lab1", Role::admin},
                             &MasterClient::undeploy);
  verbs.add<ChangeInstances>(
      Verb::Card{"start", "Let driver instances produce again", "iotcloud start 3f2a9c", Role::operating},
      &MasterClient::start);
  verbs.add<Restart>();
  verbs.add<Metadata>();
  verbs.add<Update>();
  verbs.add<ChangeInstances>(
      Verb::Card{"stop", "Let driver instances pause; they stay deployed",
                 "iotcloud stop 3f2a9c 77b1\n  iotcloud stop --where 'site == \"lab\"'", Role::operating},
      &MasterClient::stop);
}

namespace {

class ForgetGateway final : public Verb {
 public:
  ForgetGateway()
      : Verb({"forget",
              "Remove lost gateways that do not come back from the registry, with the orders and records of their "
              "driver instances",
              "iotcloud gateway forget lab1", Role::admin}) {}

  void declare(CLI::App& options) override {
    options.add_option("GATEWAY", selection_.gateways, "ids of gateways")->required();
  }
  int run(Call& call) override {
    const auto master = call.connect();
    const std::string order = discovery::to_json<nlohmann::ordered_json>(selection_).dump();
    return show_order(call, master->give("forgetGateway", order, selection_.wait));
  }

 private:
  GatewaySelection selection_;
};

}  // namespace

void add_drain_verbs(Verbs& verbs) {
  verbs.group("gateway", "Gateways that are gone for good").add<ForgetGateway>();
  verbs.add<Drain>(false);
  verbs.add<Drain>(true);
}

}  // namespace iotcloud::master::cli
