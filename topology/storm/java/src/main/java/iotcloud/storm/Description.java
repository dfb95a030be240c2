package iotcloud.storm;

import java.util.ArrayList;
import java.util.Arrays;
import java.util.Collection;
import java.util.Collections;
import java.util.HashMap;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.TreeMap;
import java.util.stream.Collectors;
import org.apache.storm.Config;
import org.apache.storm.generated.GlobalStreamId;
import org.apache.storm.generated.Grouping;
import org.apache.storm.shade.net.minidev.json.JSONValue;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.task.WorkerTopologyContext;

/** What C++ is told of a task, as JSON (topology/storm/shim/task_description.h). */
final class Description {
  private Description() {}

  /** The folder into which Storm puts what stands below resources/ in the topology's jar. */
  static String folder(WorkerTopologyContext context) {
    return context.getCodeDir();
  }

  /** The streams that feed a bolt, in an order that does not depend on the worker. */
  static List<GlobalStreamId> inputs(TopologyContext context) {
    List<GlobalStreamId> inputs = new ArrayList<>();
    for (GlobalStreamId source : context.getThisSources().keySet()) {
      if (!source.get_componentId().startsWith("__")) {
        inputs.add(source);
      }
    }
    Collections.sort(inputs);
    return inputs;
  }

  /** The streams that a component declares, in an order that does not depend on the worker. */
  static List<Output> outputs(TopologyContext context) {
    List<Output> outputs = new ArrayList<>();
    context.getThisStreams().stream().filter(stream -> !stream.startsWith("__")).sorted()
        .forEach(stream -> outputs.add(new Output(context, stream)));
    return outputs;
  }

  /** `emits`: the component's outputs(). */
  static String of(Origin origin, TopologyContext context, List<Output> emits) {
    String component = context.getThisComponentId();
    List<Object> inputs = new ArrayList<>();
    for (GlobalStreamId source : inputs(context)) {
      Grouping grouping = context.getThisSources().get(source);
      Map<String, Object> input =
          stream(source.get_componentId(), source.get_streamId(),
              context.getComponentOutputFields(source.get_componentId(), source.get_streamId()).toList());
      input.put("key", grouping.is_set_fields() ? grouping.get_fields() : Collections.emptyList());
      inputs.add(input);
    }
    List<Object> outputs = new ArrayList<>();
    for (Output emitted : emits) {
      String stream = emitted.stream;
      boolean direct = context.getRawTopology().get_spouts().containsKey(component)
          ? context.getRawTopology().get_spouts().get(component).get_common().get_streams().get(stream).is_direct()
          : context.getRawTopology().get_bolts().get(component).get_common().get_streams().get(stream).is_direct();
      Map<String, Object> output = stream(component, stream, context.getThisOutputFields(stream).toList());
      output.put("direct", direct);
      output.put("targets", direct ? readers(context, stream) : Collections.emptyList());
      output.put("parcels", emitted.parcels);
      output.put("told", Arrays.stream(emitted.told).boxed().collect(Collectors.toList()));
      outputs.add(output);
    }
    return json(origin, context, component, context.getThisTaskId(), inputs, outputs);
  }

  /** Of a task that emits to a stream with a grouping of ours. */
  static String ofEmitter(Origin origin, WorkerTopologyContext context, GlobalStreamId stream, int task) {
    String component = stream.get_componentId();
    Map<String, Object> output = stream(component, stream.get_streamId(),
        context.getComponentOutputFields(component, stream.get_streamId()).toList());
    output.put("direct", false);
    output.put("targets", Collections.emptyList());
    output.put("parcels", false);
    output.put("told", Collections.emptyList());
    return json(origin, context, component, task, Collections.emptyList(),
        Collections.singletonList(output));
  }

  private static Map<String, Object> stream(String component, String stream, List<String> fields) {
    Map<String, Object> described = new HashMap<>();
    described.put("component", component);
    described.put("stream", stream);
    described.put("fields", fields);
    return described;
  }

  private static List<Integer> readers(TopologyContext context, String stream) {
    List<Integer> tasks = new ArrayList<>();
    Map<String, Grouping> targets = context.getThisTargets().getOrDefault(stream, Collections.emptyMap());
    for (String reader : targets.keySet()) {
      tasks.addAll(context.getComponentTasks(reader));
    }
    Collections.sort(tasks);
    return tasks;
  }

  private static Map<String, List<Integer>> tasks(WorkerTopologyContext context) {
    Map<String, List<Integer>> tasks = new TreeMap<>();
    for (Map.Entry<Integer, String> task : context.getTaskToComponent().entrySet()) {
      if (!task.getValue().startsWith("__")) {
        tasks.computeIfAbsent(task.getValue(), id -> new ArrayList<>()).add(task.getKey());
      }
    }
    tasks.values().forEach(Collections::sort);
    return tasks;
  }

  private static List<Integer> here(WorkerTopologyContext context, String component) {
    List<Integer> tasks = new ArrayList<>(context.getComponentTasks(component));
    tasks.retainAll(context.getThisWorkerTasks());
    Collections.sort(tasks);
    return tasks;
  }

  private static String json(Origin origin, WorkerTopologyContext context, String component, int task,
      Collection<Object> inputs, Collection<Object> outputs) {
    Map<String, Object> all = new LinkedHashMap<>();
    all.put("folder", folder(context));
    all.put("file", origin.file);
    all.put("library", origin.library);
    all.put("class", origin.className);
    all.put("conf", origin.conf);
    all.put("topology", context.getConf().get(Config.TOPOLOGY_NAME));
    all.put("component", component);
    all.put("task", task);
    all.put("tasks", tasks(context));
    all.put("here", here(context, component));
    all.put("inputs", inputs);
    all.put("outputs", outputs);
    return JSONValue.toJSONString(all);
  }
}
