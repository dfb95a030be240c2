// record, info, play: no master is asked
#include <CLI/CLI.hpp>

#include <iotcloud/master/cli/plugins/sibling_program.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

namespace {

/// A verb that the program iotcloud-recorder carries out.
class OfRecorder : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the recording, an MCAP file")->required()->type_name("FILE");
  }
  int run(Call&) override {
    std::vector<std::string> words{card.name, file_};
    for (const auto& [name, values] : given_) {
      for (const auto& value : values) words.insert(words.end(), {name, value});
    }
    for (const auto& [name, given] : flags_) {
      if (given) words.push_back(name);
    }
    become_sibling("iotcloud-recorder", words);
  }

 protected:
  void add(CLI::App& options, const std::string& name, const char* what, const char* type) {
    options.add_option(name, given_[name.substr(name.rfind(',') + 1)], what)->type_name(type)->allow_extra_args(false);
  }
  void add_flag(CLI::App& options, const std::string& name, const char* what) {
    options.add_flag(name, flags_[name], what);
  }
  void add_system(CLI::App& options) {
    add(options, "--config",
        "YAML with the keys zk.servers, registry.* and brokers of a topology's file; it may be one", "FILE");
    add(options, "--registry", "the registry's URL; zookeeper://127.0.0.1:2181", "URL");
    add(options, "--broker", "where a logical broker is, in place of what channels' records say", "NAME=URL");
    add(options, "--log-level", "debug, info, warn (as it is), error or off", "LEVEL");
  }

 private:
  std::string file_;
  std::map<std::string, std::vector<std::string>> given_;  ///< by option, as the program takes them
  std::map<std::string, bool> flags_;
};

class Record final : public OfRecorder {
 public:
  Record()
      : OfRecorder({"record", "Record channels of driver instances into a new file, which `iotcloud play` plays",
                    "iotcloud record --where 'driver == \"meter\"' --seconds 60 meters.mcap", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    OfRecorder::declare(options);
    add(options, "--where", "which instances: an expression over their metadata; all", "EXPR");
    add(options, "--channel", "a channel's name; again for each further one; all", "NAME");
    add(options, "--direction", "of channels, as their drivers see it: out (as it is), in or both", "DIRECTION");
    add(options, "--seconds", "end after so many", "N");
    add(options, "--messages", "end after so many", "N");
    add(options, "--megabytes", "end when the file has so many", "N");
    add(options, "--compression", "zstd (as it is), lz4 or none", "WORD");
    add(options, "--group", "go on as this group, whose recorder was killed", "GROUP");
    add_system(options);
  }
};

class Info final : public OfRecorder {
 public:
  Info()
      : OfRecorder({"info", "Say what is in a recording, an MCAP file of any program",
                    "iotcloud info --check meters.mcap", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    OfRecorder::declare(options);
    add_flag(options, "--check", "read all of it, and compare all checksums");
    add(options, "-o,--output", "table (as it is), json or yaml", "FORMAT");
  }
};

class Play final : public OfRecorder {
 public:
  Play()
      : OfRecorder({"play", "Play a recording into the running system, or to a topology in one process",
                    "iotcloud play meters.mcap --topology topology.yaml --speed 10", std::nullopt, false}) {}
  void declare(CLI::App& options) override {
    OfRecorder::declare(options);
    add(options, "--topology", "play to the topology of this YAML file, without any server", "FILE");
    add(options, "--speed", "2 plays twice as fast; 0 as fast as the channels take it", "X");
    add_flag(options, "--loop", "again and again");
    add(options, "--times", "the messages' times: recorded (as it is) or now", "WHICH");
    add(options, "--instance", "only this recorded instance: id or name; again for each further one", "ID");
    add(options, "--channel", "only this channel; again for each further one", "NAME");
    add_flag(options, "--in", "channels to drivers, too: commands are given again");
    add(options, "--to", "the instance that takes a recorded one's place; again for each further one", "RECORDED=ID");
    add_system(options);
  }
};

}  // namespace

void add_recording_verbs(Verbs& verbs) {
  verbs.add<Record>();
  verbs.add<Info>();
  verbs.add<Play>();
}

}  // namespace iotcloud::master::cli
