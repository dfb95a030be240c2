package iotcloud.storm;

import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.Collections;
import java.util.List;
import java.util.Map;
import java.util.concurrent.ConcurrentHashMap;
import org.apache.storm.generated.GlobalStreamId;
import org.apache.storm.grouping.CustomStreamGrouping;
import org.apache.storm.task.WorkerTopologyContext;

/** A grouping of a component library. Storm makes one for each executor that emits, which has an object of C++ for each
 * of its tasks. Besides the executor, the thread of ticks emits for some of them. */
public class CppGrouping implements CustomStreamGrouping {
  private static final long serialVersionUID = 1;
  private static final int BUFFER_SIZE = 1 << 16;
  private final Origin origin;
  private final String bolt;
  private final int input;
  private transient WorkerTopologyContext context;
  private transient GlobalStreamId stream;
  private transient int[] targets;
  private transient Map<Integer, Emitter> emitters;

  /** The grouping of one input of a bolt of the topology's file. */
  public CppGrouping(String file, String bolt, Integer input) {
    this.origin = new Origin(file);
    this.bolt = bolt;
    this.input = input;
  }

  /** A class of a component library, for Flux and Java. */
  public CppGrouping(String library, String className) {
    Library.read(library).requireGrouping(className);
    this.origin = new Origin(library, className, Collections.emptyMap());
    this.bolt = "";
    this.input = 0;
  }

  @Override
  public void prepare(WorkerTopologyContext worker, GlobalStreamId from, List<Integer> tasks) {
    context = worker;
    stream = from;
    targets = tasks.stream().mapToInt(Integer::intValue).sorted().toArray();
    emitters = new ConcurrentHashMap<>();
    Native.load(Description.folder(worker));
  }

  /** Throws a GroupingError when C++ throws, and for a value that C++ cannot have. */
  @Override
  public List<Integer> chooseTasks(int task, List<Object> values) {
    try {
      return emitters.computeIfAbsent(task, Emitter::new).choose(values);
    } catch (ValueWriter.NoValue error) {
      throw new GroupingError(error.of(source(), context.getComponentOutputFields(stream).get(error.place())));
    } catch (RuntimeException error) {
      throw new GroupingError("the grouping of " + source() + " threw: " + error.getMessage());
    }
  }

  private String source() {
    return stream.get_componentId() + "/" + stream.get_streamId();
  }

  /** The object of one emitting task. */
  private final class Emitter {
    private final long handle;
    private final ValueWriter writer;
    private final ByteBuffer chosen =
        ByteBuffer.allocateDirect(Integer.BYTES * (targets.length + 1)).order(ByteOrder.LITTLE_ENDIAN);

    Emitter(int task) {
      handle = Native.makeGrouping(
          Description.ofEmitter(origin, context, stream, task).getBytes(StandardCharsets.UTF_8),
          bolt.getBytes(StandardCharsets.UTF_8), input, targets);
      writer = new ValueWriter(BUFFER_SIZE, false, buffer -> Native.setGroupingBuffers(handle, buffer, chosen));
    }

    List<Integer> choose(List<Object> values) {
      int count = Native.choose(handle, writer.write(values));
      List<Integer> tasks = new ArrayList<>(count);
      for (int i = 0; i < count; i++) {
        tasks.add(chosen.getInt(i * Integer.BYTES));
      }
      return tasks;
    }
  }
}
