package iotcloud.storm;

import java.util.Collections;
import java.util.HashSet;
import java.util.List;
import java.util.Map;
import java.util.Set;
import org.apache.storm.Config;
import org.apache.storm.generated.Bolt;
import org.apache.storm.generated.ComponentObject;
import org.apache.storm.generated.Grouping;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.tuple.Fields;
import org.apache.storm.utils.Utils;

/** A stream that a task of C++ emits, and whether large payloads in it stay in C++ (topology/storm/shim/parcel.h). */
final class Output {
  final String stream;
  /** Whether each tuple goes to one task of a bolt of C++, of which some are in this worker. */
  final boolean parcels;
  /** The places of the values by which Storm groups the tuples of such a stream. */
  final int[] told;
  private final Set<Integer> elsewhere = new HashSet<>(); // its tasks in other workers

  Output(TopologyContext context, String stream) {
    this.stream = stream;
    Map<String, Grouping> readers = context.getThisTargets().getOrDefault(stream, Collections.emptyMap());
    String reader = readers.size() == 1 ? readers.keySet().iterator().next() : null;
    parcels = reader != null && choosesOne(readers.get(reader)) && isOfCpp(context, reader)
        && !Collections.disjoint(context.getComponentTasks(reader), context.getThisWorkerTasks())
        && !othersLook(context.getConf());
    if (!parcels) {
      told = new int[0];
      return;
    }
    elsewhere.addAll(context.getComponentTasks(reader));
    elsewhere.removeAll(context.getThisWorkerTasks());
    Grouping grouping = readers.get(reader);
    Fields fields = context.getThisOutputFields(stream);
    told = grouping.is_set_fields() ? grouping.get_fields().stream().mapToInt(fields::fieldIndex).distinct().toArray()
        : new int[0];
  }

  /** Storm's own groupings but `all` do, and look at no other values than those of `fields`. */
  private static boolean choosesOne(Grouping grouping) {
    return !grouping.is_set_all() && !grouping.is_set_custom_object() && !grouping.is_set_custom_serialized();
  }

  private static boolean isOfCpp(TopologyContext context, String component) {
    Bolt bolt = context.getRawTopology().get_bolts().get(component);
    if (bolt == null) {
      return false;
    }
    ComponentObject made = bolt.get_bolt_object();
    return made.is_set_java_object() ? made.get_java_object().get_full_class_name().equals(CppBolt.class.getName())
        : Utils.getSetComponentObject(made) instanceof CppBolt;
  }

  /** Storm then reads values of tuples after they were executed: for its log, for its event logger, or for hooks. */
  private static boolean othersLook(Map<String, Object> conf) {
    Object loggers = conf.get(Config.TOPOLOGY_EVENTLOGGER_EXECUTORS);
    Object hooks = conf.get(Config.TOPOLOGY_AUTO_TASK_HOOKS);
    return Boolean.TRUE.equals(conf.get(Config.TOPOLOGY_DEBUG))
        || loggers instanceof Number && ((Number) loggers).intValue() > 0
        || hooks instanceof List && !((List<?>) hooks).isEmpty();
  }

  /** A parcel that leaves the worker is copied, if Storm did not do so while it sent the tuple. */
  void wasSent(List<Object> values, List<Integer> tasks) {
    if (values instanceof Parcel && (tasks.isEmpty() || !elsewhere.isEmpty() && elsewhere.contains(tasks.get(0)))) {
      ((Parcel) values).open();
    }
  }
}
