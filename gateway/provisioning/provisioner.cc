#include <algorithm>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/instance_name.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/provisioning/kept_things.h>
#include <iotcloud/gateway/provisioning/provisioner.h>

namespace iotcloud::gateway {

using discovery::InstanceId;
using discovery::OrderRecord;
using std::chrono::milliseconds;

namespace {

/// An instance is made anew for what changed at most this often.
constexpr milliseconds settle{10'000};
constexpr milliseconds tell_pause{1000};
/// Undeployed instances that a finder's metadata name.
constexpr std::size_t most_named = 10;
/// Time until an instance is made again whose order is gone.
constexpr milliseconds return_pause{2000};
/// Time until something that waits for a token is tried again.
constexpr milliseconds token_pause{50};
constexpr double log_lines_a_second = 5;
void sooner(std::optional<milliseconds>& next, milliseconds pause) {
  pause = std::max(pause, milliseconds{1});
  next = next ? std::min(*next, pause) : pause;
}

milliseconds until(config::Clock::Instant due, config::Clock::Instant now) {
  return std::chrono::ceil<milliseconds>(due - now);
}

OrderRecord named_order(const discovery::GatewayId& gateway, const std::string& name) {
  OrderRecord order;
  order.name = name;
  order.index = 1;
  order.instance = discovery::named_instance_id(gateway, name, order.index);
  return order;
}

/// What an instance would have to be made anew for.
bool is_made_alike(const OrderRecord& a, const OrderRecord& b) {
  return a.instance == b.instance && a.driver == b.driver && a.plugin == b.plugin && a.properties == b.properties;
}

}  // namespace

Provisioner::Provisioner(Options options) : options_(std::move(options)) {
  make_finders();
}

Provisioner::~Provisioner() {
  if (!unsaved_) return;
  try {
    save();
  } catch (const std::exception& e) {
    logger.error("what was found last is not kept: {}", e.what());
  }
}

const DeployRule* Provisioner::rule_named(const std::string& name) const {
  const auto& rules = options_.rules.rules;
  const auto found = std::find_if(rules.begin(), rules.end(), [&](const auto& rule) { return rule.name == name; });
  return found == rules.end() ? nullptr : &*found;
}

void Provisioner::make_finders() {
  std::map<std::string, Finder> before;
  before.swap(finders_);
  finder_names_.clear();
  for (const auto& rule : options_.rules.finders) {
    Finder& finder = finders_[rule.name];
    if (const auto known = before.find(rule.name); known != before.end()) finder = std::move(known->second);
    finder.order = named_order(options_.gateway, rule.name);
    finder.order.plugin = rule.plugin;
    finder.order.properties = rule.properties;
    finder.order.made_by = "finder " + rule.name;
    finder_names_[finder.order.instance] = rule.name;
  }
}

void Provisioner::begin(const std::set<InstanceId>& adopted) {
  if (std::exchange(begun_, true)) return;
  load();
  untold_ = true;
  for (const auto& [name, finder] : finders_) carry_out(finder.order);
  for (auto& [address, thing] : things_) consider(address, thing);
  std::optional<milliseconds> next;
  make_waiting(next);
  for (const auto& instance : adopted) {
    const bool wanted = owners_.contains(instance) || finder_names_.contains(instance) || ordered_.contains(instance);
    if (!wanted) options_.end(instance);
  }
}

void Provisioner::set_rules(ProvisioningRules rules) {
  const auto before = std::exchange(options_.rules, std::move(rules));
  const auto finders_before = finder_names_;
  make_finders();
  std::vector<Address> orphans;
  for (const auto& [address, thing] : things_) {
    if (!finders_.contains(address.first)) orphans.push_back(address);
  }
  for (const auto& address : orphans) forget(address);
  if (!begun_) return;
  for (const auto& [instance, name] : finders_before) {
    if (!finder_names_.contains(instance) && !ordered_.contains(instance)) options_.end(instance);
  }
  for (const auto& [name, finder] : finders_) carry_out(finder.order);
  for (auto& [address, thing] : things_) consider(address, thing);
  untold_ = true;
}

void Provisioner::heard(const FoundReport& report) {
  const auto name = finder_names_.find(report.finder);
  if (name == finder_names_.end()) {
    logger.debug("the instance {} tells what it finds, and is no finder of this gateway's rules", report.finder);
    return;
  }
  Finder& finder = finders_.at(name->second);
  const bool sees_again = report.whole || report.sees != finder.sees;
  finder.sees = report.sees;
  if (sees_again) {
    for (const auto& key : finder.keys) {
      Thing& thing = things_.at({name->second, key});
      thing.present = false;
      thing.missing.reset();
      if (report.sees) thing.missing = options_.clock->now();
    }
  }
  for (const auto& key : report.gone) miss({name->second, key});
  for (const auto& found : report.found) take(name->second, found);
  untold_ = true;
}

void Provisioner::take(const std::string& finder_name, const FoundThing& found) {
  Finder& finder = finders_.at(finder_name);
  if (const std::string problem = problem_of(found); !problem.empty()) {
    if (may_log()) logger.warn("finder {}: something that it found is passed over: {}", finder_name, problem);
    return;
  }
  const Address address{finder_name, found.key};
  const bool fresh = !things_.contains(address);
  if (fresh && finder.keys.size() >= most_found) {
    if (!std::exchange(finder.refused_more, true))
      logger.error("finder {} finds more than {} things; the rest is passed over", finder_name, most_found);
    return;
  }
  finder.keys.insert(found.key);
  Thing& thing = things_[address];
  thing.present = true;
  thing.missing.reset();
  if (!fresh && thing.attributes == found.attributes) return;
  thing.attributes = found.attributes;
  if (thing.made) unsaved_ = true;
  if (begun_) consider(address, thing);
}

void Provisioner::miss(const Address& address) {
  const auto found = things_.find(address);
  if (found == things_.end()) return;
  found->second.present = false;
  if (!found->second.missing) found->second.missing = options_.clock->now();
}

/// Finds out which instance the thing is to have.
void Provisioner::consider(const Address& address, Thing& thing) {
  discovery::DriverRecord as_record;
  as_record.metadata = thing.attributes;
  as_record.name = discovery::DriverName(address.first);
  const auto& rules = options_.rules.rules;
  const auto rule = std::find_if(rules.begin(), rules.end(), [&](const DeployRule& candidate) {
    return candidate.finder == address.first && candidate.where.matches(as_record);
  });
  OrderRecord order;
  std::string problem;
  if (rule != rules.end()) problem = plan(*rule, thing, order);
  const bool wanted = rule != rules.end() && problem.empty();
  if (thing.made && (!wanted || thing.rule != rule->name || thing.order.instance != order.instance)) unmake(thing);
  thing.rule = rule == rules.end() ? "" : rule->name;
  blocked_.erase(address);
  if (!wanted) {
    waiting_.erase(address);
    thing.problem.clear();
    if (!problem.empty()) refuse(thing, address.second, rule->name, "value", problem);
    return;
  }
  const bool as_it_is = thing.made && is_made_alike(thing.order, order) && thing.order.metadata == order.metadata;
  thing.order = std::move(order);
  if (!as_it_is) waiting_.insert(address);
}

/// Fills the rule's templates. \return why they cannot be filled; empty: they are
std::string Provisioner::plan(const DeployRule& rule, Thing& thing, OrderRecord& order) const {
  const auto name = rule.instance.fill(thing.attributes);
  if (!name.text)
    return name.missing.empty() ? name.problem : fmt::format("it has no attribute \"{}\" for its name", name.missing);
  try {
    check_name("name of an instance", *name.text);
  } catch (const config::Error& e) {
    return e.what();
  }
  order = named_order(options_.gateway, *name.text);
  order.plugin = rule.plugin;
  order.driver = discovery::DriverName(rule.driver);
  order.made_by = "rule " + rule.name;
  for (const auto& [from, into] :
       {std::pair{&rule.properties, &order.properties}, std::pair{&rule.metadata, &order.metadata}}) {
    for (const auto& [key, value] : *from) {
      auto filled = value.fill(thing.attributes);
      if (!filled.problem.empty()) return filled.problem;
      if (filled.text) into->emplace(key, *std::move(filled.text));  // what was not found is left out
    }
  }
  return "";
}

/// What keeps a thing from having its instance, whatever the rule's rate is.
std::string Provisioner::obstacle(const Address& address, const Thing& thing) const {
  const InstanceId& instance = thing.order.instance;
  if (finder_names_.contains(instance)) return fmt::format("a finder has the name \"{}\"", thing.order.name);
  const auto owner = owners_.find(instance);
  if (owner != owners_.end() && owner->second != address)
    return fmt::format("\"{}\", which was found before, has the name \"{}\"", owner->second.second, thing.order.name);
  return "";
}

bool Provisioner::take_token(const DeployRule& rule) {
  return buckets_[rule.name].tokens.take(options_.clock->now(), rule.rate);
}

void Provisioner::make_waiting(std::optional<milliseconds>& next) {
  const auto now = options_.clock->now();
  std::set<std::string> exhausted;  // rules without a token
  for (auto at = waiting_.begin(); at != waiting_.end();) {
    const Address address = *at;
    Thing& thing = things_.at(address);
    const DeployRule& rule = *rule_named(thing.rule);
    const bool only_described = thing.made && thing.problem.empty();
    if (exhausted.contains(rule.name) || (draining_ && !thing.kept)) {
      ++at;
      continue;
    }
    if (const std::string problem = obstacle(address, thing); !problem.empty()) {
      refuse(thing, address.second, rule.name, "name", problem);
      blocked_.insert(address);
      at = waiting_.erase(at);
      continue;
    }
    if (!thing.made && buckets_[rule.name].made >= rule.most) {
      refuse(thing, address.second, rule.name, "most",
             fmt::format("the rule {} has its {} instances (most)", rule.name, rule.most));
      blocked_.insert(address);
      at = waiting_.erase(at);
      continue;
    }
    if (only_described && now - thing.changed < settle) {
      sooner(next, until(thing.changed + settle, now));
      ++at;
      continue;
    }
    if (!thing.kept && !take_token(rule)) {
      exhausted.insert(rule.name);
      sooner(next, std::max(token_pause, milliseconds(static_cast<std::int64_t>(1000 / rule.rate))));
      ++at;
      continue;
    }
    at = waiting_.erase(at);
    make(address, thing);
  }
}

void Provisioner::make(const Address& address, Thing& thing) {
  thing.problem.clear();
  thing.changed = options_.clock->now();
  thing.kept = false;
  if (!std::exchange(thing.made, true)) {
    ++buckets_[thing.rule].made;
    owners_[thing.order.instance] = address;
    options_.metrics
        ->counter("iotcloud_provisioning_made_total", "Instances that a rule made of what was found",
                  {{"rule", thing.rule}})
        .add();
    logger.info("rule {}: {} {} is made for \"{}\"", thing.rule, thing.order.name, thing.order.instance,
                address.second);
  }
  unsaved_ = untold_ = true;
  carry_out(thing.order);
}

void Provisioner::unmake(Thing& thing) {
  thing.made = false;
  --buckets_[thing.rule].made;
  owners_.erase(thing.order.instance);
  waiting_.merge(blocked_);
  blocked_.clear();
  unsaved_ = untold_ = true;
  if (!ordered_.contains(thing.order.instance)) options_.end(thing.order.instance);
}

/// Runs an instance as it is to be run, by what a person said about it, unless a master has ordered it.
void Provisioner::carry_out(const OrderRecord& order, bool again) {
  if (ordered_.contains(order.instance) || returning_.contains(order.instance)) return;
  const auto word = words_.find(order.instance);
  if (word == words_.end()) return options_.run(order, again);
  if (word->second.withheld) return options_.end(order.instance);
  OrderRecord wanted = order;
  wanted.active = word->second.active;
  options_.run(wanted, again);
}

void Provisioner::carry_out_now(const InstanceId& instance, bool again) {
  if (!begun_) return;
  if (const auto finder = finder_names_.find(instance); finder != finder_names_.end()) {
    carry_out(finders_.at(finder->second).order, again);
  } else if (const auto owner = owners_.find(instance); owner != owners_.end()) {
    carry_out(things_.at(owner->second).order, again);
  }
}

void Provisioner::forget(const Address& address) {
  const auto found = things_.find(address);
  if (found->second.made) unmake(found->second);
  waiting_.erase(address);
  blocked_.erase(address);
  if (const auto finder = finders_.find(address.first); finder != finders_.end())
    finder->second.keys.erase(address.second);
  things_.erase(found);
}

/// Whether what strangers announce may make another line of the log, which has a few of these a second.
bool Provisioner::may_log() {
  return log_tokens_.take(options_.clock->now(), log_lines_a_second);
}

/// Notes why a thing gets no instance.
void Provisioner::refuse(Thing& thing, const std::string& key, const std::string& rule, const char* kind,
                         const std::string& problem) {
  if (thing.problem == problem) return;
  thing.problem = problem;
  untold_ = true;
  options_.metrics
      ->counter("iotcloud_provisioning_refused_total", "Found things of which a rule makes no instance",
                {{"rule", rule}, {"reason", kind}})
      .add();
  if (!may_log()) return;
  logger.warn("rule {}: no instance for \"{}\": {}", rule, key, problem);
}

void Provisioner::ordered(const InstanceId& instance) {
  words_.erase(instance);
  returning_.erase(instance);
  ordered_.insert(instance);
}

void Provisioner::said(const OrderRecord& word) {
  ordered_.erase(word.instance);
  returning_.erase(word.instance);
  words_[word.instance] = {word.active, word.withheld};
  untold_ = true;
  carry_out_now(word.instance, word.active);
}

void Provisioner::unsaid(const InstanceId& instance) {
  const bool was_order = ordered_.erase(instance) > 0 || !words_.contains(instance);
  words_.erase(instance);
  if (!was_order) return carry_out_now(instance, false);
  options_.end(instance);
  if (finder_names_.contains(instance) || owners_.contains(instance))
    returning_[instance] = options_.clock->now() + return_pause;
}

void Provisioner::bring_back(Instant now, std::optional<milliseconds>& next) {
  std::vector<InstanceId> back;
  for (const auto& [instance, due] : returning_) {
    if (now >= due) {
      back.push_back(instance);
    } else {
      sooner(next, until(due, now));
    }
  }
  for (const auto& instance : back) {
    returning_.erase(instance);
    carry_out_now(instance, false);
  }
}

void Provisioner::set_draining(bool draining) {
  draining_ = draining;
}

void Provisioner::end_missing(Instant now, std::optional<milliseconds>& next) {
  std::vector<Address> over;
  for (const auto& [address, thing] : things_) {
    if (!thing.missing || !finders_.at(address.first).sees) continue;
    const DeployRule* rule = rule_named(thing.rule);
    const auto due = *thing.missing + (rule != nullptr && thing.made ? rule->grace : milliseconds{0});
    if (now >= due) {
      over.push_back(address);
    } else {
      sooner(next, until(due, now));
    }
  }
  for (const auto& address : over) {
    const Thing& thing = things_.at(address);
    if (thing.made) {
      options_.metrics
          ->counter("iotcloud_provisioning_ended_total", "Instances that ended because what they were for is gone",
                    {{"rule", thing.rule}})
          .add();
      logger.info("rule {}: {} {} ends: \"{}\" is gone", thing.rule, thing.order.name, thing.order.instance,
                  address.second);
    }
    forget(address);
    untold_ = true;
  }
}

/// Shows in the metadata of the finders what became of what they found.
void Provisioner::tell_finders(Instant now, std::optional<milliseconds>& next) {
  if (!untold_) return;
  if (told_ && now - *told_ < tell_pause) return sooner(next, until(*told_ + tell_pause, now));
  untold_ = false;
  told_ = now;
  for (auto& [name, finder] : finders_) {
    std::size_t made = 0, refused = 0, withheld = 0;
    std::string problem, names;
    for (const auto& key : finder.keys) {
      const Thing& thing = things_.at({name, key});
      if (thing.made) ++made;
      const auto word = words_.find(thing.order.instance);
      if (thing.made && word != words_.end() && word->second.withheld && ++withheld <= most_named)
        names += (names.empty() ? "" : ", ") + thing.order.name + " " + thing.order.instance.str();
      if (thing.problem.empty()) continue;
      if (refused++ == 0) problem = thing.problem;
    }
    std::map<std::string, std::string> metadata{{"found", std::to_string(finder.keys.size())},
                                                {"made", std::to_string(made)}};
    if (refused > 0) {
      metadata["refused"] = std::to_string(refused);
      metadata["refused_first"] = problem;
    }
    if (withheld > 0) metadata["undeployed"] = withheld > most_named ? names + ", ..." : names;
    if (metadata == finder.order.metadata) continue;
    finder.order.metadata = std::move(metadata);
    carry_out(finder.order);
  }
}

std::optional<milliseconds> Provisioner::work() {
  std::optional<milliseconds> next;
  if (!begun_) return next;
  const auto now = options_.clock->now();
  bring_back(now, next);
  end_missing(now, next);
  make_waiting(next);
  tell_finders(now, next);
  keep(now, next);
  return next;
}

void Provisioner::keep(Instant now, std::optional<milliseconds>& next) {
  if (!unsaved_) return;
  if (saved_ && now - *saved_ < save_pause_) return sooner(next, until(*saved_ + save_pause_, now));
  saved_ = now;
  try {
    save();
    unsaved_ = false;
  } catch (const config::Error& e) {
    logger.error("what was found is not kept, it is tried again: {}", e.what());
    sooner(next, save_pause_);
  }
}

void Provisioner::save() {
  if (options_.file.empty()) return;
  std::vector<KeptThing> things;
  for (const auto& [address, thing] : things_) {
    if (thing.made) things.push_back({address.first, {address.second, thing.attributes}});
  }
  const std::size_t bytes = write_kept_things(options_.file, things);
  // A file of many megabytes is written seldom.
  save_pause_ = milliseconds{1000} + milliseconds(static_cast<std::int64_t>(bytes >> 10));
}

/// Takes up what an earlier run of the gateway had made instances of.
void Provisioner::load() {
  if (options_.file.empty()) return;
  for (auto& kept : read_kept_things(options_.file)) {
    const auto finder = finders_.find(kept.finder);
    if (finder == finders_.end() || finder->second.keys.size() >= most_found) continue;
    const Address address{kept.finder, kept.thing.key};
    if (things_.contains(address)) continue;  // this run has found it already
    finder->second.keys.insert(kept.thing.key);
    Thing& thing = things_[address];
    thing.attributes = std::move(kept.thing.attributes);
    thing.kept = true;
    if (finder->second.sees) thing.missing = options_.clock->now();
  }
}

}  // namespace iotcloud::gateway
