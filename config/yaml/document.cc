#include <algorithm>
#include <cstddef>
#include <map>
#include <set>
#include <sstream>
#include <string_view>
#include <vector>

#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/yaml.h>

#include <iotcloud/config/yaml/document.h>

namespace iotcloud::config::internal {
namespace {

constexpr std::size_t deepest = 32;           ///< collections in collections
constexpr std::size_t most_values = 500'000;  ///< about two seconds and 400 MB for yaml-cpp

/// Inspects a document before its tree is built, and throws if building or walking the tree would not end: for yaml-cpp
/// 0.7 a text that begins with a comma has any number of empty documents (its YAML::LoadAll never returns), and a few
/// aliases of aliases stand for more values than anybody can walk.
class Inspection : public YAML::EventHandler {
 public:
  Inspection(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  void OnDocumentStart(const YAML::Mark& mark) override {
    if (documents_++ == 0) return;
    const auto offset = std::min(text_.size(), static_cast<std::size_t>(std::max(0, mark.pos)));
    if (text_.substr(offset).starts_with("---")) {
      throw ConfigError(location(name_, mark), "", "a second document begins here",
                        "remove the line \"---\"; only one document is read");
    }
    throw ConfigError(location(name_, mark), "", "what begins here does not belong to what stands before it",
                      "check the indentation, and look for a comma or colon too many");
  }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override {
    count(1, mark);
    add({}, anchor);
  }
  void OnScalar(const YAML::Mark& mark, const std::string& /*tag*/, YAML::anchor_t anchor,
                const std::string& /*value*/) override {
    count(1, mark);
    add({}, anchor);
  }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t anchor) override {
    const auto target = anchors_.find(anchor);
    if (target == anchors_.end()) {
      throw ConfigError(location(name_, mark), "", "this alias contains itself", "write out what is meant");
    }
    count(target->second.values, mark);
    refuse_depth(open_.size() + target->second.height, mark);
    add(target->second, YAML::NullAnchor);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string& /*tag*/, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value /*style*/) override {
    open(mark, anchor);
  }
  void OnSequenceEnd() override { close(); }
  void OnMapStart(const YAML::Mark& mark, const std::string& /*tag*/, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value /*style*/) override {
    open(mark, anchor);
  }
  void OnMapEnd() override { close(); }

 private:
  /// The size of a value when all aliases in it are written out.
  struct Extent {
    std::size_t values = 1;  ///< this value and all values in it
    std::size_t height = 0;  ///< depth of nested collections, this one included
  };
  struct Open {
    YAML::anchor_t anchor;
    Extent extent;
  };

  void open(const YAML::Mark& mark, YAML::anchor_t anchor) {
    count(1, mark);
    refuse_depth(open_.size() + 1, mark);
    open_.push_back({anchor, {1, 1}});
  }
  void close() {
    const Open closed = open_.back();
    open_.pop_back();
    add(closed.extent, closed.anchor);
  }
  void add(const Extent& value, YAML::anchor_t anchor) {
    if (anchor != YAML::NullAnchor) anchors_[anchor] = value;
    if (open_.empty()) return;
    Extent& parent = open_.back().extent;
    parent.values += value.values;
    parent.height = std::max(parent.height, value.height + 1);
  }
  void count(std::size_t more, const YAML::Mark& mark) {
    values_ += more;
    if (values_ <= most_values) return;
    throw ConfigError(location(name_, mark), "",
                      "this text has more than " + std::to_string(most_values) +
                          " values, when what an alias stands for is counted each time",
                      "split it, or use fewer aliases of aliases");
  }
  void refuse_depth(std::size_t depth, const YAML::Mark& mark) const {
    if (depth <= deepest) return;
    throw ConfigError(location(name_, mark), "", "this is nested too deeply",
                      "at most " + std::to_string(deepest) + " levels are read");
  }

  const std::string_view text_;
  const std::string& name_;
  int documents_ = 0;
  std::vector<Open> open_;
  std::map<YAML::anchor_t, Extent> anchors_;  ///< finished anchors only
  std::size_t values_ = 0;
};

std::string join(const std::string& path, const std::string& key) {
  return path.empty() ? key : path + "." + key;
}

/// Finds duplicate keys anywhere below `node`: yaml-cpp would silently take the first.
void find_duplicates(const YAML::Node& node, const std::string& file, const std::string& path,
                     std::vector<ConfigError>& errors) {
  if (errors.size() >= most_errors) return;
  if (node.IsMap()) {
    std::set<std::string> seen;
    for (const auto& entry : node) {
      if (!entry.first.IsScalar()) {
        throw ConfigError(location(file, entry.first.Mark()), path, "a key must be a single word", "quote it");
      }
      const std::string& key = entry.first.Scalar();
      if (!seen.insert(key).second) {
        errors.emplace_back(location(file, entry.first.Mark()), join(path, key), "this key stands here twice",
                            "remove one of them");
      }
      find_duplicates(entry.second, file, join(path, key), errors);
    }
  } else if (node.IsSequence()) {
    for (std::size_t i = 0; i < node.size(); ++i) {
      find_duplicates(node[i], file, path + "[" + std::to_string(i) + "]", errors);
    }
  }
}

/// What is wrong at a line may be because of a TAB that indents it or the line before: names that TAB.
void refuse_tab(const std::string& text, const std::string& name, int line) {
  std::istringstream lines(text);
  std::string content;
  for (int number = 1; number <= line && std::getline(lines, content); ++number) {
    const auto tab = content.find_first_not_of(' ');
    if (number + 1 < line || tab == std::string::npos || content[tab] != '\t') continue;
    throw ConfigError({name, number, static_cast<int>(tab) + 1}, "", "a TAB stands in the indentation here",
                      "YAML is indented by spaces only: set the editor to write spaces for the key TAB");
  }
}

}  // namespace

Location location(const std::string& file, const YAML::Mark& mark) {
  if (mark.is_null()) return {file, 0, 0};
  return {file, mark.line + 1, mark.column + 1};
}

YAML::Node read_document(const std::string& text, const std::string& name, std::vector<ConfigError>& duplicates) {
  YAML::Node document;
  try {
    std::istringstream stream(text);
    YAML::Parser parser(stream);
    Inspection inspection(text, name);
    while (parser.HandleNextDocument(inspection)) {
    }
    document.reset(YAML::Load(text));
  } catch (const ConfigError& e) {
    refuse_tab(text, name, e.where().line);
    throw;
  } catch (const YAML::Exception& e) {
    refuse_tab(text, name, location(name, e.mark).line);
    throw ConfigError(location(name, e.mark), "", "this is not YAML: " + e.msg, "");
  }
  find_duplicates(document, name, "", duplicates);
  return document;
}

}  // namespace iotcloud::config::internal
