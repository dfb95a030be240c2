// check, support-bundle: the program iotcloud-check carries them out
#include <cstdlib>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

namespace {

class OfCheck : public Verb {
 public:
  using Verb::Verb;
  int run(Call&) override {
    std::vector<std::string> words{card.name};
    if (!file_.empty()) words.push_back(file_);
    for (const auto& [name, values] : given_) {
      for (const auto& value : values) words.insert(words.end(), {name, value});
    }
    become_sibling("iotcloud-check", words);
  }

 protected:
  void add(CLI::App& options, const std::string& name, const char* what, const char* type) {
    options.add_option(name, given_[name.substr(name.rfind(',') + 1)], what)->type_name(type)->allow_extra_args(false);
  }
  void add_common(CLI::App& options) {
    add(options, "--config", "a daemon's file; again for each further one; those in /etc/iotcloud", "FILE");
    add(options, "--limit", "how long registry and brokers may take to answer: 5", "S");
  }

  std::string file_;

 private:
  std::map<std::string, std::vector<std::string>> given_;  ///< by option, as the program takes them
};

class Check final : public OfCheck {
 public:
  Check()
      : OfCheck(
            {"check",
             "Look at ports, certificates, clock, brokers, registry, plugins and disk of this machine, and say how to "
             "mend what is wrong",
             "iotcloud check --config /etc/iotcloud/gateway.yaml", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    add_common(options);
    add(options, "-o,--output", "table (as it is), json or yaml", "FORMAT");
  }
};

class SupportBundle final : public OfCheck {
 public:
  SupportBundle()
      : OfCheck({"support-bundle",
                 "Pack versions, configuration, what the master says, and logs for somebody who helps; secrets are "
                 "left out",
                 "iotcloud support-bundle bundle.tar.gz", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the new archive (.tar.gz)")->required()->type_name("FILE");
    add_common(options);
    add(options, "--log", "a log to pack, too; again for each further one", "FILE");
  }
  int run(Call& call) override {
    // It asks the masters by way of this program.
    const auto set = [](const char* variable, const std::string& value) {
      if (!value.empty()) setenv(variable, value.c_str(), 1);
    };
    set("IOTCLOUD_MASTER", fmt::format("{}", fmt::join(call.masters, ",")));
    set("IOTCLOUD_TOKEN", call.access.token);
    set("IOTCLOUD_CA", call.access.tls.ca);
    set("IOTCLOUD_CERTIFICATE", call.access.tls.certificate);
    set("IOTCLOUD_KEY", call.access.tls.key);
    set("IOTCLOUD_REVOKED", call.access.tls.revoked);
    return OfCheck::run(call);
  }
};

}  // namespace

void add_check_verbs(Verbs& verbs) {
  verbs.add<Check>();
  verbs.add<SupportBundle>();
}

}  // namespace iotcloud::master::cli
